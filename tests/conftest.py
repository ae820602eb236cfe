"""Shared fixtures. Programs are compiled once per session: robots are values, so every test shares them."""

import dataclasses
import os
import sys

import numpy as np
import pytest

from btr_mjx.robots import Robot, hexapod


def pytest_configure() -> None:
    """What processes of tests share: bytecode, options of the compiler, compiled programs, also of earlier sessions."""
    # Where Python keeps no bytecode, each process compiles JAX's and MuJoCo's packages again: longer than most tests.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    import jax

    from btr_mjx.engines import use_all_cores, use_compilation_cache

    use_all_cores()  # what is compiled directly gets the same options as what users compile
    use_compilation_cache()
    # JAX keeps by default what took a second to compile; programs of tests are smaller.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The hexapod, tried for 60 steps only."""
    return dataclasses.replace(hexapod(), duration=0.03)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
