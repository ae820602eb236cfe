"""Back-to-Reality on batched MuJoCo: co-evolve a robot's controller and its simulation.

    import btr_mjx as btr

    robot = btr.Robot(...)                                         # or btr.hexapod(), the robot of the paper
    evaluation = btr.evaluate(robot, simulations, controllers)     # fitness (L, M)
    btr.scan.delta_fitness(robot, simulations, controllers, f_r)   # (L,)
    result = btr.coevolve(robot, iterations=3, seed=1)             # a complete run, as the command does it

Names load on first use (`__init__.pyi` lists them): importing the package costs nothing.
"""

import importlib
from typing import Any

import lazy_loader

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    # A module that can be called: what it is for whoever imports the command's module before or after this.
    return importlib.import_module("btr_mjx.coevolve") if name == "coevolve" else _load(name)
