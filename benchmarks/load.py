"""Time and memory of a diagnosis of a long recording: `uv run python benchmarks/load.py --joints 30 --minutes 60`.

An arm with position servos follows a periodic command. One period is simulated with more damping than the believed
model has, and repeated with fresh sensor noise. The command `python -m btr_mjx.diagnose` reads it in a process of its
own. Measured are the time from the start of the process until the findings of preflight are printed, and the largest
resident memory of the process and its children, sampled 20 times a second. Needs Linux.
"""

import os
import resource
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import polars as pl
from summary_command import command

from btr_mjx.runs import progress

RATE = 1000
"""Samples per second."""
PERIOD = 20
"""Period of the commands [s]."""
NOISE = 2e-4
"""Standard deviation of the position sensors [rad]."""
DIGITS = 4
"""Decimal places in the CSV file."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    joints: int = 30
    """Joints of the arm."""
    minutes: float = 60.0
    """Length of the recording."""
    file_format: Literal["csv", "parquet"] = "csv"
    """Of the recording."""
    velocities: bool = False
    """Record velocities as well."""
    whole: bool = False
    """Wait for the end of the search, not only for the findings of preflight."""
    keep: Path | None = None
    """Folder in which datasets are kept for further measurements; None for a temporary one."""


def arm_xml(joints: int, damping: float) -> str:
    """MJCF of limbs of up to six hinges on a fixed base, with a position servo at each hinge."""
    bodies = motors = ""
    for first in range(0, joints, 6):
        count = min(6, joints - first)
        for j in range(first, first + count):
            place = f"0 {0.3 * (first // 6):g} 1" if j == first else "0 0 -0.15"
            bodies += (
                f'<body pos="{place}"><joint name="j{j}" axis="{j % 2} {1 - j % 2} 0" damping="{damping}" '
                'armature="0.01"/><geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" mass="0.3"/>'
            )
            motors += f'<position name="m{j}" joint="j{j}" kp="30" kv="1"/>'
        bodies += "</body>" * count
    return (
        '<mujoco><option timestep="0.002" integrator="implicitfast"><flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def one_period(joints: int) -> dict[str, np.ndarray]:
    """Columns of one period of the steady motion."""
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(arm_xml(joints, 0.4))
    model.opt.timestep = 1 / RATE
    data = mujoco.MjData(model)
    time_stamps = np.arange(PERIOD * RATE) / RATE
    cycles = rng.integers(2, 20, (joints, 3))
    phase = 2 * np.pi * (cycles[:, :, None] * time_stamps / PERIOD + rng.uniform(size=(joints, 3, 1)))
    ctrl = (rng.uniform(0.05, 0.2, (joints, 3, 1)) * np.sin(phase)).sum(1).T
    qpos, qvel = np.empty((len(ctrl), joints)), np.empty((len(ctrl), joints))
    for k in range(-len(ctrl), len(ctrl)):  # the first period settles
        if k >= 0:
            qpos[k], qvel[k] = data.qpos, data.qvel
        data.ctrl[:] = ctrl[k]
        mujoco.mj_step(model, data)
    columns = {f"ctrl/m{j}": ctrl[:, j] for j in range(joints)}
    columns |= {f"qpos/j{j}": qpos[:, j] for j in range(joints)}
    return columns | {f"qvel/j{j}": qvel[:, j] for j in range(joints)}


def write_long_dataset(folder: Path, config: Config) -> Path:
    """Write a dataset with one long recording, unless it exists; returns the file of the recording."""
    name = f"long.{config.file_format}"
    table, csv = folder / "dataset.toml", folder / "long.csv"
    if table.is_file() and (folder / name).is_file():
        return folder / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(arm_xml(config.joints, 0.2), encoding="utf-8")
    period, rng = one_period(config.joints), np.random.default_rng(1)
    if not config.velocities:
        period = {key: values for key, values in period.items() if not key.startswith("qvel/")}
    rows, count = round(60 * config.minutes * RATE), PERIOD * RATE
    with csv.open("wb") as file:
        for first in progress(range(0, rows, count), description=name, show=True):
            part = {"time": (first + np.arange(count)) / RATE}
            for key, values in period.items():
                noise = {"ctrl": 0.0, "qpos": NOISE, "qvel": 50 * NOISE}[key[:4]]
                part[key] = values + noise * rng.standard_normal(count)
            frame = pl.DataFrame(part)[: rows - first]
            frame.write_csv(file, include_header=first == 0, float_precision=DIGITS)
    if config.file_format == "parquet":
        pl.scan_csv(csv).sink_parquet(folder / name)
        csv.unlink()
    table.write_text(f'[model]\nfile = "model.xml"\n\n[[recording]]\nfile = "{name}"\n', encoding="utf-8")
    return folder / name


def resident(pid: int) -> int:
    """Resident memory of a process and all its children [bytes]; 0 once it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        tasks = Path(f"/proc/{pid}/task").iterdir()
        children = [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except (OSError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE") + sum(map(resident, children))


def measure(folder: Path, out: Path, whole: bool) -> dict[str, float]:
    """Run the diagnosis; time until its findings [s], and peak memory [GB]."""
    words = [sys.executable, "-m", "btr_mjx.diagnose", str(folder), "--out", str(out), "--no-figures"]
    begun, peak, said, found, bar = time.monotonic(), 0, b"", float("nan"), float("nan")
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    streams = [process.stdout, process.stderr]
    while streams:
        ready, _, _ = select.select(streams, [], [], 0.05)
        peak = max(peak, resident(process.pid))
        for stream in ready:
            text = os.read(stream.fileno(), 1 << 16)
            if not text:
                streams.remove(stream)
            elif stream is process.stderr:
                bar = time.monotonic() - begun if np.isnan(bar) else bar
                sys.stderr.write(text.decode())
            else:
                said += text
        if np.isnan(found) and b"\n\n" in said:
            found = time.monotonic() - begun
            if not whole:
                process.terminate()
                break
    process.wait()
    print(said.decode())
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "first bar [s]": bar,
        "findings [s]": found,
        "CPU [s]": used.ru_utime + used.ru_stime,
        "peak memory [GB]": peak / 1e9,
        **({"whole [s]": time.monotonic() - begun} if whole else {}),
    }


def run(config: Config) -> Mapping[str, Any]:
    """Write the dataset and measure its diagnosis."""
    with tempfile.TemporaryDirectory() as temporary:
        name = f"{config.joints}-{config.minutes:g}{'-velocities' if config.velocities else ''}-{config.file_format}"
        folder = (config.keep or Path(temporary)) / name
        file = write_long_dataset(folder, config)
        size = {"file [GB]": file.stat().st_size / 1e9}
        return {"summary": size | measure(folder, Path(temporary) / "run", config.whole)}


if __name__ == "__main__":
    command(Config, run, __doc__, None)
