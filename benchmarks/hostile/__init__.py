"""Hostile and broken inputs for every reader of files: valid seeds, mutations, and how each reader is run.

`PARSERS` names the readers. An input follows from a `random.Random`: the same state, the same input. Reading an input
ends without an error or in bad input (`errors.is_bad_input`); all else is a bug.
"""

from hostile.parsers import PARSERS, Parser, run_input, write_input

__all__ = ["PARSERS", "Parser", "run_input", "write_input"]
