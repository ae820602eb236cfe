"""Batched simulation of worlds in native MuJoCo.

A `World` is a hypothesis about the robot: a model, edits of the command, and laws that act between steps. `simulate`
runs `Job`s (a world over `Segments` of recordings) in batches on threads. `Counter` adds up the simulated steps;
`Journal` also stores the results on disk, so that an interrupted search can resume.
"""

from btr_mjx.gap.simulate.batch import Counter, simulate
from btr_mjx.gap.simulate.commands import Command, command_phase
from btr_mjx.gap.simulate.following import followed_search
from btr_mjx.gap.simulate.forward_dynamics import accelerations, actuator_forces
from btr_mjx.gap.simulate.journal import Journal
from btr_mjx.gap.simulate.laws import Rows, StateLaw
from btr_mjx.gap.simulate.needed_forces import needed_forces
from btr_mjx.gap.simulate.segments import Job, Segments
from btr_mjx.gap.simulate.threads import run_in_threads
from btr_mjx.gap.simulate.world import World, differing_fields, fingerprint

__all__ = [
    "Command",
    "Counter",
    "Job",
    "Journal",
    "Rows",
    "Segments",
    "StateLaw",
    "World",
    "accelerations",
    "actuator_forces",
    "command_phase",
    "differing_fields",
    "fingerprint",
    "followed_search",
    "needed_forces",
    "run_in_threads",
    "simulate",
]
