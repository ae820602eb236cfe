"""The search: candidates are scanned, leaders refined by true simulation, rivals compared."""
