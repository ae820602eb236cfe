"""How a batch of pairs is stepped: `lanes` (the fast one), `mjx` (general, any device), `native` (the oracle)."""
