"""`python odd_parser.py FOLDER`: fuzz a reader that does what its inputs say, keep what is reported in FOLDER.

A program of its own, because it forks: a process of tests, which has the threads of JAX, may hang then.
"""

import json
import multiprocessing
import os
import sys
import time
from pathlib import Path

import fuzz
from hostile import Parser

from btr_mjx.errors import InputError


def behave(folder: Path) -> None:
    """What the number in an input says."""
    match int((folder / "a.txt").read_bytes()) % 5:
        case 0:
            raise InputError("refused")
        case 1:
            raise KeyError("a bug")
        case 2:
            os._exit(11)
        case 3:
            time.sleep(60)


if __name__ == "__main__":
    fuzz.PARSERS["odd"] = Parser(lambda source: {"a.txt": source}, behave)
    fuzz.source = lambda name, seed, number: str(number).encode()
    fuzz.get_context = lambda method: multiprocessing.get_context("fork")  # new processes would not have this reader
    print(json.dumps(fuzz.fuzz("odd", fuzz.FuzzConfig(inputs=10, limit=1.0, keep=Path(sys.argv[1])))))
