"""Laws that no library has, hidden in arms: `uv run python benchmarks/laws.py --cases 20 --json after.json`.

    uv run python benchmarks/laws.py --robot legged --cases 6     # a ripple at a knee, another name is wrong

Arms are those of `field_cases`, without faults of data. The force of what was named is compared with that of the hidden
law on states of another motion: an answer is right within 25 % (root mean square), and a dead band by its name. Laws
are not sought where a robot touches the world: there "unexplained" is right, and any name is wrong. A case is made once
and kept, an answer is kept under the digest of the code that computed it.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
import tyro
from case_runs import Files
from field_gate import solve
from hidden_cases.field_cases import FRESH, Wanted, make_case
from hidden_cases.field_laws import LAWS, found_force, true_force
from naming_gate import CODE

from btr_mjx.errors import cli_errors
from btr_mjx.runs import note, read_json, write_json

CLOSE = 0.25
"""Largest error of a force, as a part of that of the law (root mean square)."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: int = 20
    """Number of cases; kinds of laws in turn."""
    seed: int = 1
    """Seed of the cases."""
    robot: Literal["arm", "legged"] = "arm"
    """Robot of the cases; one on legs hides a ripple."""
    out: Path = Path("runs/laws")
    """Folder of the cases and of the answers of all versions."""
    json: Path | None = None
    """Write the rows of all cases here."""


def judge(data: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Row of a case: what was hidden and named, and the error of the force."""
    (hidden,) = truth["effects"]
    model = mujoco.MjModel.from_xml_path(str(data / "model.xml"))
    named = [f"{e['effect']}@{e['location']}" for e in answer["effects"]]
    row = {
        "hidden": f"{hidden.get('kind', hidden['effect'])}@{hidden['location']}",
        "said": answer["verdict"],
        "named": named,
        "error": float("nan"),
        "visible": truth["visible"][0],
        "seconds": answer["cpu_seconds"],
        "sentence": answer["sentence"],
    }
    if hidden["effect"] == "backlash":
        return row | {"right": named == [f"backlash@{hidden['location']}"]}
    fresh = np.load(data.with_name(FRESH))
    true = true_force(hidden, model, fresh["qpos"], fresh["qvel"], fresh["time"])
    found = found_force(answer["effects"], model, *(fresh[name] for name in ("qpos", "qvel", "torque", "time")))
    error = float(np.sqrt(((found - true) ** 2).sum() / (true**2).sum()))
    honest = truth["robot"] == "legged" and answer["verdict"] == "unexplained" and not named
    return row | {"error": error, "right": honest or (answer["verdict"] == "effect" and error <= CLOSE)}


def case(config: Config, index: int) -> dict[str, Any]:
    """Make and solve a case, unless its answer is kept."""
    name = f"{config.robot}-{config.seed}-{index:04d}"
    files, kept = Files(config.out / name, index), config.out / "answers" / CODE / f"{name}.json"
    kind = LAWS[index % len(LAWS)] if config.robot == "arm" else "ripple"
    if not files.truth.is_file():
        seed = int(np.random.SeedSequence([config.seed, index]).generate_state(1)[0])
        write_json(files.truth, make_case(files.data, seed, config.robot, Wanted(1, (), kind)))
    if not kept.is_file():
        write_json(kept, solve(files.data))
    row = {"case": name, **judge(files.data, read_json(files.truth), read_json(kept))}
    note(
        f"{name} {row['hidden']} ({row['visible']:.0f} noises): {row['said']} {' + '.join(row['named']) or 'nothing'}, "
        f"error {row['error']:.2f}, {'right' if row['right'] else 'wrong'}, {row['seconds']:.0f} CPU-s"
    )
    return row


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    mujoco.set_mju_user_warning(lambda _: None)
    with cli_errors():
        rows = [case(config, index) for index in range(config.cases)]
        if config.json is not None:
            write_json(config.json, {"code": CODE, "rows": rows})
        unexplained = sum(row["said"] == "unexplained" for row in rows)
        print(f"right {sum(row['right'] for row in rows)} of {len(rows)}, unexplained {unexplained}")


if __name__ == "__main__":
    main()
