"""Definition of a robot: an MJCF template, the space S of simulations, the space C of controllers, a reference signal.

`Robot` holds them, `Box` is a bounded space with a bit-string code, `hexapod` is the robot of the paper. Any other
robot is one more `Robot`; the commands take the hexapod unless another template is given.
"""

from btr_mjx.robots.hexapod import HEXAPOD, PAPER_REALITIES, PAPER_STARTS, hexapod, read_asset
from btr_mjx.robots.robot import Edit, Pairs, Robot, Signal, Simulator, read_template
from btr_mjx.robots.signals import Sinusoids, Spline
from btr_mjx.robots.spaces import Box

__all__ = [
    "HEXAPOD",
    "PAPER_REALITIES",
    "PAPER_STARTS",
    "Box",
    "Edit",
    "Pairs",
    "Robot",
    "Signal",
    "Simulator",
    "Sinusoids",
    "Spline",
    "hexapod",
    "read_asset",
    "read_template",
]
