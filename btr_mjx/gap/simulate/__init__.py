"""Worlds and their simulation by the thousand in native MuJoCo.

A `World` is one way the robot could be: a model, a command and laws that act between steps. `simulate` runs `Job`s in
batches on threads, `Counter` adds up the steps, and a `Journal` keeps the answers of a search that may be killed.
"""

from btr_mjx.gap.simulate.batch import Counter, simulate
from btr_mjx.gap.simulate.commands import Command
from btr_mjx.gap.simulate.journal import Journal
from btr_mjx.gap.simulate.laws import Rows
from btr_mjx.gap.simulate.stretches import Job, Stretch
from btr_mjx.gap.simulate.threads import abreast
from btr_mjx.gap.simulate.world import World, fields_of, fingerprint

__all__ = [
    "Command",
    "Counter",
    "Job",
    "Journal",
    "Rows",
    "Stretch",
    "World",
    "abreast",
    "fields_of",
    "fingerprint",
    "simulate",
]
