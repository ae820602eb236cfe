"""The hidden case of `diagnose --demo`: a robot that has an effect of the library and the errors of a calibration.

`make_demo` writes its recordings, `make_fitness_demo` a table of trials. No other room imports this one.
"""

from btr_mjx.demo.cases import make_demo, make_fitness_demo
from btr_mjx.demo.robots import DemoRobot, MotionCommand, demo_robot

__all__ = ["DemoRobot", "MotionCommand", "demo_robot", "make_demo", "make_fitness_demo"]
