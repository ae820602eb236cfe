"""The README.md of an exchange folder: what whoever stands beside the robot has to know."""

from dataclasses import dataclass

import mujoco

from btr_mjx.evaluation import FitnessFunction, track_configurations
from btr_mjx.models import base_model, control_names, part_names, start_of
from btr_mjx.robots import Robot


@dataclass(frozen=True)
class Rounds:
    """How a run goes on.

    Attributes:
      iterations: rounds after the first controller, at most; 0 where it is not known.
      trials: controllers of each.
      command: what continues the run; "" where it is not known.
    """

    iterations: int = 0
    trials: int = 0
    command: str = ""


def instructions(robot: Robot, fitness: FitnessFunction, rate: float, rounds: Rounds) -> str:
    """The text of README.md; `rate` is in samples of the reference signals per second."""
    follow = ""
    if rounds.iterations:
        follow = (
            f"\n`trials/000.csv` is the first controller. At most {rounds.iterations} rounds of {rounds.trials} "
            "controllers follow, each after the one before has been measured.\n"
        )
    return _README.format(
        name=robot.name,
        duration=f"{robot.duration:g}",
        fitness=fitness_in_words(robot, fitness),
        rate=f"{rate:g}",
        follow=follow,
        start=_start_pose(robot),
        commands="\n".join(f"   - `ctrl/{name}`: {kind}" for name, kind in command_kinds(base_model(robot)).items()),
        command=rounds.command or "the command of the run with --resume",
    )


def fitness_in_words(robot: Robot, fitness: FitnessFunction) -> str:
    """What a fitness measures, with its unit."""
    what, end = robot.point or robot.base_body or "the base", f"{robot.duration:g}"
    moved = f"between t = 0 and {end} s"
    unit = f" [{fitness.unit}]" if fitness.unit else ""
    known = {
        "distance": f"horizontal distance of `{what}` from its start, {moved}, divided by {end} s, in any direction",
        "forward_speed": f"displacement of `{what}` along x {moved}, divided by {end} s; negative backwards",
        "energy_per_metre": f"mechanical work of all motors over the horizontal distance of `{what}` {moved}",
        "target_distance": f"distance of `{what}` from the point {list(robot.target)} m at t = {end} s",
    }
    words = known.get(fitness.name, f"`{fitness.name}`, as the function computes it from the motion {moved}")
    return f"{words}{unit}; {'larger' if fitness.maximise else 'smaller'} is better"


def command_kinds(model: mujoco.MjModel) -> dict[str, str]:
    """Control -> what it means, with the unit."""
    joints, controls, out = part_names(model, "joint"), control_names(model), dict[str, str]()
    for i, first in enumerate(model.actuator_ctrladr.tolist()):
        gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
        on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        joint = int(model.actuator_trnid[i, 0])
        slides = on_joint and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        length, force = ("m", "N") if slides else ("rad", "N m")
        where = f" of joint `{joints[joint]}`" if on_joint else ""
        plain = abs(model.actuator_gear[i, 0] - 1) < 1e-9
        pid = model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_PID
        if (pid and model.actuator_ctrlspec[i] == mujoco.mjtCtrlInput.mjINPUT_POS) or (
            not pid and bias[1] < 0 and gain[0] == -bias[1]
        ):
            kind = f"position{where} [{length}]"
        elif not pid and bias[1] == 0 and bias[2] < 0 and gain[0] == -bias[2]:
            kind = f"velocity{where} [{length}/s]"
        elif not bias.any() and gain[0] == 1 and plain and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE:
            kind = f"{'force' if slides else 'torque'}{where} [{force}]"
        else:
            kind = f"control{where}, as the actuator of the model takes it"
        out |= dict.fromkeys(controls[first : first + int(model.actuator_ctrlnum[i])], kind)
    return out


def _start_pose(robot: Robot) -> str:
    """Values of all joints at t = 0, a list item each."""
    model, start = base_model(robot), start_of(robot)
    qpos = model.qpos0 if start is None else start[0]
    lines = []
    for j, name in enumerate(part_names(model, "joint")):
        first, kind = int(model.jnt_qposadr[j]), model.jnt_type[j]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            place, turn = (" ".join(f"{v:.4g}" for v in qpos[first + a : first + b]) for a, b in ((0, 3), (3, 7)))
            body = model.body(int(model.jnt_bodyid[j])).name
            lines.append(f"`{body}` at x y z = {place} m, orientation {turn} (quaternion w x y z)")
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            turn = " ".join(f"{v:.4g}" for v in qpos[first : first + 4])
            lines.append(f"`{name}`: {turn} (quaternion w x y z)")
        else:
            unit = "m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
            lines.append(f"`{name}`: {qpos[first]:.4g} {unit}")
    if robot.point:
        place = " ".join(f"{v:.4g}" for v in track_configurations(robot, qpos[None])[0])
        lines.append(f"`{robot.point}` is then at x y z = {place} m")
    return "\n".join(f"   - {line}" for line in lines)


_README = """# Trials of {name}

`trials/NNN.csv` lists controllers to be tried on the robot: an id, and the controller's parameters.
{follow}
1. Put the robot into its start pose, at rest unless the model's keyframe says otherwise:

{start}

2. Play `signals/trial-ID.csv` on its motors: `time` [s] and one column for each motor, {rate} rows a second for
   {duration} s:

{commands}

3. Write what came out, for every id, in one of these ways:

   - `measured/NNN.csv` (the same number as in `trials/`) with the columns `id,fitness`, such as

         id,fitness,failed
         1,0.412,
         2,0.371,
         2,0.383,
         3,,1

     The fitness is the {fitness}. Further rows of the same id (trial 2 here) are repeats: they are averaged, and their
     scatter tells how exact a measurement is. A column `failed` with 1 (trial 3) marks a trial without a valid
     measurement (a motor stopped, the tracking was lost). A fall is not a failure if the simulation counts it: write
     the fitness that was reached.
   - `measured/trial-ID.csv` (or .parquet, .npz): a recording with the columns `time`, `qpos/JOINT` of every joint and
     `ctrl/MOTOR` of every motor, as for `python -m btr_mjx.diagnose`. The fitness is computed from it.

4. Go on (a command that was started with `--wait` does so by itself):

       {command}

   It says what is still missing, and which rows it could not use.

Do not change files in `trials/`, `signals/` and `used/`.
"""
