"""Hidden cases with a sealed truth, for benchmarks and tests.

`make_case` writes recordings of a simulated reality with an effect that the believed model lacks, drawn from a seed;
`make_fitness_case` writes a table of trials. `field_cases`, `imu_walks`, `changed_arms` and `torque_arms` make cases
like those that users bring. The simulators of reality share no code with the search.
"""

from hidden_cases.case_sampling import PER_JOINT_EFFECTS, Missing
from hidden_cases.cases import CaseSettings, Truth, draw_reality, make_case
from hidden_cases.fitness_cases import FitnessCaseSettings, case_draw, make_fitness_case
from hidden_cases.robots import case_robot

__all__ = [
    "PER_JOINT_EFFECTS",
    "CaseSettings",
    "FitnessCaseSettings",
    "Missing",
    "Truth",
    "case_draw",
    "case_robot",
    "draw_reality",
    "make_case",
    "make_fitness_case",
]
