"""Back-to-Reality on batched MuJoCo: co-evolve a robot's controller and its simulation.

    import btr_mjx as btr

    robot = btr.Robot(...)                                         # or btr.hexapod(), the robot of the paper
    evaluation = btr.evaluate(robot, simulations, controllers)     # fitness (L, M)
    btr.scan.delta_fitness(robot, simulations, controllers, f_r)   # (L,)
    btr.coevolve(preset="quick", out="runs/demo")                  # a complete run, as the command does it

Names load on first use (`__init__.pyi` lists them): importing the package costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
