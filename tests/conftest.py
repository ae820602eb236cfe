"""Shared fixtures. Programs are compiled once per session: robots are values, so every test shares them."""

import dataclasses
import os
import sys

import numpy as np
import pytest

from btr_mjx.robots import Robot, hexapod


def pytest_configure() -> None:
    """What this process and those that tests start share: bytecode, options of the compiler, compiled programs."""
    # Where Python keeps no bytecode, each process compiles JAX's and MuJoCo's packages again: longer than most tests.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    # Programs of tests are small: JAX keeps by default only those that took a second to compile.
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    from btr_mjx.engines import use_all_cores, use_compilation_cache  # reads these settings when it loads JAX

    use_all_cores()  # what is compiled directly gets the same options as what users compile
    use_compilation_cache()


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The hexapod, tried for 60 steps only."""
    return dataclasses.replace(hexapod(), duration=0.03)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
