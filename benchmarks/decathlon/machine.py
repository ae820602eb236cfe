"""What a machine of the decathlon states, how fetched copies are read, and how its dataset folder is written."""

import json
import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import polars

from btr_mjx.errors import InputError

FREE = {"qpos": ("x", "y", "z", "qw", "qx", "qy", "qz"), "qvel": ("vx", "vy", "vz", "wx", "wy", "wz")}
"""Columns of a free joint."""


@dataclass(frozen=True)
class Copies:
    """Copies of public repositories: a subfolder for each, a git directory or a checkout.

    Attributes:
      folder: that holds them, named like the repositories without their owners.
    """

    folder: Path

    def place(self, repository: str) -> Path:
        """Folder of a repository "owner/name".

        Raises:
          InputError: there is none.
        """
        place = self.folder / repository.rpartition("/")[2]
        if not place.is_dir():
            raise InputError(f"{place}: there is no copy; git clone https://github.com/{repository} {place}")
        return place

    def read(self, repository: str, revision: str, path: str) -> bytes:
        """A file at a revision, or of a folder without git."""
        place = self.place(repository)
        if (place / path).is_file() and not (place / ".git").exists():
            return (place / path).read_bytes()
        return _git(place, "show", f"{revision}:{path}")

    def text(self, repository: str, revision: str, path: str) -> str:
        """The same as text."""
        return self.read(repository, revision, path).decode()

    def names(self, repository: str, revision: str, path: str) -> list[str]:
        """Sorted names in a folder at a revision."""
        listed = _git(self.place(repository), "ls-tree", "--name-only", revision, f"{path}/").decode()
        return sorted(line.rpartition("/")[2] for line in listed.splitlines())


@dataclass(frozen=True, eq=False)
class Log:
    """A recording: time (K,) [s], ctrl (K, nu), qpos (K, nq) and, where it was measured, qvel (K, nv)."""

    name: str
    split: Literal["fit", "test"]
    time: np.ndarray
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray | None = None
    own_model: str = ""

    def part(self, first: float, last: float, split: Literal["fit", "test"], name: str) -> "Log":
        """Samples between two shares of the recording."""
        rows = slice(int(first * len(self.time)), int(last * len(self.time)))
        qvel = None if self.qvel is None else self.qvel[rows]
        return replace(
            self, name=name, split=split, time=self.time[rows], ctrl=self.ctrl[rows], qpos=self.qpos[rows], qvel=qvel
        )


@dataclass(frozen=True, eq=False)
class Trial:
    """Believed MJCF and recordings; `models` are MJCF by file name, for recordings with a model of their own."""

    xml: str
    logs: tuple[Log, ...]
    interpolation: Literal["hold", "linear"] | None
    models: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Machine:
    """A machine of the decathlon.

    Attributes:
      name: of the machine.
      about: what it is, what its commands are and what is believed of it: the text of its module.
      source: repository and path inside it.
      licence: of the data, and whether they may be redistributed.
      citation: whom to cite.
      split: what is fitted and what is held out.
      make: from copies to the trial.
      unit: of the error.
      specialists: published or known error of others on the same recordings; None where there is none.
      figure: how that number is computed.
      horizon: time over which predictions are compared [s]; None for whole recordings.
      skip: samples at the beginning of each prediction that do not count.
      dofs: degrees of freedom that count; all if empty.
      measure: root mean square or mean of the error of positions over all samples, or mean norm of the error of a free
        joint's angular velocity at the end of the horizon.
      share: of the predictions, those with the smallest errors, that count: some systems diverge from any model.
      published: numbers that the specialists found, by field of the model, "gain" or "offset"; see `rivals`.
    """

    name: str
    about: str
    source: str
    licence: str
    citation: str
    split: str
    make: Callable[[Copies], Trial]
    unit: str
    specialists: float | None
    figure: str
    horizon: float | None = None
    skip: int = 0
    dofs: tuple[int, ...] = ()
    measure: Literal["rms", "mean", "spin"] = "rms"
    share: float = 1.0
    published: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def write_trial(trial: Trial, folder: Path) -> None:
    """Write a dataset folder: dataset.toml, MJCF and a Parquet file for each recording."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, xml in {"model.xml": trial.xml, **trial.models}.items():
        (folder / name).write_text(xml)
    columns = _columns(mujoco.MjModel.from_xml_string(trial.xml))
    lines = ["[model]", 'file = "model.xml"']
    if trial.interpolation:
        lines += ["[control]", f"interpolation = {json.dumps(trial.interpolation)}"]
    for log in trial.logs:
        table = {"time": log.time}
        for kind, values in (("ctrl", log.ctrl), ("qpos", log.qpos), ("qvel", log.qvel)):
            if values is not None:
                table |= dict(zip(columns[kind], np.asarray(values, float).T, strict=True))
        polars.DataFrame(table).write_parquet(folder / f"{log.name}.parquet")
        lines += ["[[recording]]", f'file = "{log.name}.parquet"', f'split = "{log.split}"']
        lines += [f'model = "{log.own_model}"'] if log.own_model else []
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")


def halves(trial: Trial) -> tuple[Trial, Trial]:
    """The trial with every second recording to fit, or with the first and second half of one recording."""
    fit = [log for log in trial.logs if log.split == "fit"]
    test = [log for log in trial.logs if log.split != "fit"]
    if len(fit) == 1:
        fit = [fit[0].part(share, share + 0.5, "fit", f"{fit[0].name}_{i}") for i, share in enumerate((0.0, 0.5))]
    first, second = (replace(trial, logs=(*fit[k::2], *test)) for k in (0, 1))
    return first, second


def arm_from_urdf(urdf: str, compiler: str = "") -> str:
    """MJCF of an arm without meshes, friction and limits, with a torque motor at every joint, from its URDF."""
    urdf = re.sub(r"<!--.*?-->", "", urdf, flags=re.S)
    urdf = re.sub(r"<(visual|collision|gazebo|transmission)\b[^>]*?(/>|>.*?</\1>)", "", urdf, flags=re.S)
    extra = f'<mujoco><compiler fusestatic="true" balanceinertia="true" {compiler}/></mujoco>'
    spec = mujoco.MjSpec.from_string(urdf.replace("</robot>", f"{extra}</robot>"))
    spec.option.timestep, spec.option.integrator = 0.001, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in spec.joints:
        joint.name = joint.name.removesuffix("_joint")
        joint.damping[:], joint.frictionloss, joint.limited = 0.0, 0.0, 0
        motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    spec.compile()
    return str(spec.to_xml())


def _columns(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Names of the columns in the order of ctrl, qpos and qvel."""
    out: dict[str, list[str]] = {"ctrl": [f"ctrl/{model.actuator(i).name}" for i in range(model.nu)]}
    for kind, parts in FREE.items():
        out[kind] = []
        for j in range(model.njnt):
            free, name = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE, f"{kind}/{model.joint(j).name}"
            out[kind] += [f"{name}/{part}" for part in parts] if free else [name]
    return out


def _git(place: Path, *words: str) -> bytes:
    """Output of git in a bare directory or a checkout.

    Raises:
      InputError: the copy does not have what was asked for.
    """
    folder = place / ".git" if (place / ".git").exists() else place
    done = subprocess.run(["git", "--git-dir", str(folder), *words], capture_output=True)
    if done.returncode:
        raise InputError(f"{place}: {done.stderr.decode().strip()}")
    return done.stdout
