"""Shared fixtures. Programs are compiled once per session: robots are values, so every test shares them."""

import dataclasses
import os
import sys

import numpy as np
import pytest

from btr_mjx.engines import use_all_cores
from btr_mjx.robots import Robot, hexapod

# Tests start many processes, and where Python may not keep bytecode each of them compiles JAX and MuJoCo's packages
# again, which takes longer than most tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

use_all_cores()  # before any test touches JAX: what is compiled directly gets the same options as what users compile


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The hexapod, tried for 60 steps only."""
    return dataclasses.replace(hexapod(), duration=0.03)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
