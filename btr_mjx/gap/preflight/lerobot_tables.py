"""Tables of dataset.toml that declare names and signs of a LeRobot dataset's joints."""

from collections.abc import Sequence

from btr_mjx.gap.data import DATASET_FILE, Answer, Dataset, driven_joint, quoted
from btr_mjx.gap.preflight.predictions import Change
from btr_mjx.models import part_names


def joint_lines(dataset: Dataset, change: Change) -> tuple[str, ...]:
    """What to write where joints of a LeRobot dataset are exchanged or count the other way round, and to run then.

    There are no lines for other changes, which cannot be declared: names and signs are those of states and of actions.
    """
    model, tables = dataset.model, list[str]()
    joints, owner = part_names(model, "joint"), {int(q): j for j, q in enumerate(model.jnt_qposadr)}
    servo = {joint: a for a in range(model.nu) if (joint := driven_joint(model, a)) is not None}
    for q, joint in owner.items():
        source = owner.get(int(change.qpos.source[q]))
        scale = dataset.scales.get(joints[source]) if source is not None else None
        if scale is None:
            continue
        drive, other = servo.get(joint), servo.get(owner[int(change.qpos.source[q])])
        if drive is not None and (change.ctrl.source[drive], change.ctrl.scale[drive]) != (other, change.qpos.scale[q]):
            return ()
        turned = float(change.qpos.scale[q]) == -1.0
        own = [f"joint = {quoted(joints[joint])}"] if source != joint else []
        own += [f"sign = {-scale.sign}"] if turned else []
        tables += [scale.heading, *own] if own else []
    return toml_lines(dataset, tables) if tables else ()


def toml_lines(dataset: Dataset, tables: Sequence[str]) -> tuple[str, ...]:
    """Lines that hold `tables`: the whole dataset.toml where there is none yet, what to add otherwise."""
    head = dataset.inferred.partition("\n[lerobot.joints")[0]
    head = "\n".join(line for line in head.splitlines() if not line.startswith("#")).strip()
    return tuple(Answer(dataset.folder / DATASET_FILE, head).lines(tables))
