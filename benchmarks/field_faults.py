"""Field cases with a fault each: `uv run python benchmarks/field_faults.py --cases FOLDER --json OUT.json`.

FOLDER has a subfolder for each of `CASES`: a believed model and logs with a fault of data, of the model or of physics.
Each runs through the command as a user gives it, the check first. The table says what was wanted, what was got, and the
CPU-seconds of the diagnosis; a case is right where all that was wanted holds. An answer is kept under the digest of the
code, so that the same command continues a killed run.
Exit code: 1 where a case is not right, 2 for bad input.
"""

import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tyro
from gates.answers import CODE

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import note, read_json, write_json


@dataclass(frozen=True)
class Answer:
    """What the command said of a case.

    Attributes:
      usable: whether the check accepts the data.
      said: all findings of the check in one text.
      result: content of result.json; empty where there is none.
    """

    usable: bool
    said: str
    result: Mapping[str, Any]

    @property
    def verdict(self) -> str:
        """Verdict of the diagnosis; "refused" or "no answer" where there is none."""
        return str(self.result.get("verdict", "no answer" if self.usable else "refused"))

    def sizes(self, effect: str, place: str) -> list[float]:
        """Values of the first parameter of an effect where it is named at a place, also as a member of a group."""
        member, out = place.partition(":")[2], []
        for named in self.result.get("effects", []):
            if named["effect"] != effect:
                continue
            for key, number in named["parameters"].items():
                if named["location"] == place or key.endswith(f"[{member}]"):
                    out.append(float(number["value"]))
        return out

    def others(self, effect: str, place: str) -> list[str]:
        """Names of what else is named, beside an effect at a place."""
        return [
            f"{n['effect']}@{n['location']}"
            for n in self.result.get("effects", [])
            if n["effect"] != effect or not (n["location"] == place or n["location"].startswith("each:"))
        ]

    @property
    def told(self) -> str:
        """All that is told in sentences: findings of the check, what is left, and notes."""
        return "\n".join([self.said, *self.result.get("unexplained", []), *self.result.get("notes", [])]).lower()


@dataclass(frozen=True)
class Case:
    """A case.

    Attributes:
      words: of the command line behind the name of the command, paths inside the case's folder.
      wanted: right answer in words.
      is_right: whether an answer is right.
    """

    words: tuple[str, ...]
    wanted: str
    is_right: Callable[[Answer], bool]


def _is_none(answer: Answer) -> bool:
    return answer.verdict == "none"


def _tells(*words: str) -> Callable[[Answer], bool]:
    return lambda answer: all(word in answer.told for word in words)


def _alone(effect: str, place: str, low: float, high: float) -> Callable[[Answer], bool]:
    """An effect at a place within a range, and nothing else that is not small beside it."""

    def is_right(answer: Answer) -> bool:
        found = answer.sizes(effect, place)
        return any(low <= size <= high for size in found) and not answer.others(effect, place)

    return is_right


def _law_or_unexplained(*kinds: str) -> Callable[[Answer], bool]:
    """A law of one of some kinds, or nothing named and something told to be left."""

    def is_right(answer: Answer) -> bool:
        named = [n["effect"] for n in answer.result.get("effects", [])]
        return answer.verdict == "unexplained" or (bool(named) and all(name in kinds for name in named))

    return is_right


def _torque_constant(answer: Answer) -> bool:
    gains = answer.sizes("actuator_gain", "all") or answer.sizes("actuator_gain", "each:actuator:all")
    named = bool(gains) and all(-0.57 < gain < -0.47 for gain in gains) and not answer.others("actuator_gain", "all")
    return named or ("current" in answer.told and ("0.48" in answer.told or "-0.52" in answer.told))


def _payload_and_delay(answer: Answer) -> bool:
    delays, masses = answer.sizes("actuator_delay", "all"), answer.sizes("payload", "body:link7")
    return any(0.03 <= d <= 0.042 for d in delays) and any(1.2 <= m <= 1.8 for m in masses)


def _asymmetric(answer: Answer) -> bool:
    """Friction of 0.35 one way and 0.08 the other is friction of 0.215 and a constant torque of 0.135."""
    offset, rest = "offset_torque@joint:lift", answer.others(*_LIFT_FRICTION)
    partly = answer.verdict == "unexplained" or any(0.1 <= size <= 0.3 for size in answer.sizes(*_LIFT_FRICTION))
    return (partly and set(rest) <= {offset}) or "law" in str(answer.result.get("effects"))


_LIFT_FRICTION = ("dry_friction", "joint:lift")


CASES: Mapping[str, Case] = {
    "odrive_turns/turns": Case(
        ("leg.xml", "turns/*"),
        "refused; turns named, or a factor 2 pi",
        lambda a: not a.usable and any(word in a.told for word in ("turn", "revolution", "6.28", "2 pi", "2π")),
    ),
    "odrive_turns/amps": Case(
        ("leg.xml", "amps/*"), "the unit of the command, or gains -0.52 at all", _torque_constant
    ),
    "coarse_step": Case(
        (".",),
        "none, or the time step",
        lambda a: _is_none(a) or (not a.result.get("effects") and "time step" in a.told),
    ),
    "exo_two_clocks/raw": Case(
        ("leg.xml", "raw/*"),
        "positions come before their commands by about 0.12 s, less the servo's lag, and how to shift",
        lambda a: ("before their commands" in a.told and "clock" in a.told) or "shift" in a.told,
    ),
    "exo_two_clocks/aligned": Case(("leg.xml", "aligned/*"), "none", _is_none),
    "shadow_j0": Case((".",), "spring of 0.08 N m/rad at FFJ1", _alone("joint_stiffness", "joint:FFJ1", 0.06, 0.1)),
    "wrist_backlash_after": Case(
        ("forearm.xml", "after/*.csv", "--before", "before"),
        "backlash at wrist_pitch, about 0.03 rad, nothing else",
        lambda a: (
            any(0.015 <= abs(size) <= 0.04 for size in a.sizes("backlash", "actuator:wrist_pitch"))
            and len(a.result["effects"]) == 1
        ),
    ),
    "xarm7_delay_payload": Case((".",), "delay of 0.036 s at all and payload of 1.5 kg at link7", _payload_and_delay),
    "null_jitter": Case((".",), "none; stamps jitter is told", lambda a: _is_none(a) and "stamps" in a.told),
    "null_quantised": Case((".",), "none", _is_none),
    "velocity_lowpass": Case(
        (".",), "none; velocities lag and are left out", lambda a: _is_none(a) and "lag" in a.told
    ),
    "joint_order": Case(
        (".",),
        "refused; the order of the columns, breadth first, to paste",
        lambda a: not a.usable and "order" in a.told,
    ),
    "null_walking": Case((".",), "none", _is_none),
    "null_walking_velocities": Case((".",), "none", _is_none),
    "torque_speed": Case(
        (".",), "the line of torque over speed, or unexplained", _law_or_unexplained("law_torque_speed", "torque_speed")
    ),
    "gravcomp": Case(
        (".",),
        "gravity compensation, found or told, or unexplained",
        lambda a: a.verdict == "unexplained" or "gravity" in a.told or bool(a.sizes("gravity_compensation", "world")),
    ),
    "asym_friction": Case(
        (".",), "both frictions as a law, or friction at lift of about 0.2 with a part unexplained", _asymmetric
    ),
    "battery_sag": Case(
        (".",),
        "strength that fades with time, or weaker motors and that it falls with time",
        lambda a: bool(a.sizes("fading_motor", "all")) or "time" in " ".join(a.result.get("unexplained", [])),
    ),
    "gripper_removed_tau": Case(
        (".",),
        "payload of -0.73 kg at right_hand, or that the range ends there",
        lambda a: any(
            -0.76 <= mass <= -0.64
            for body in ("right_hand", "gripper")  # the gripper is welded to the hand
            for mass in a.sizes("payload", f"body:{body}")
        ),
    ),
    "load_friction_walking": Case(
        (".",), "load friction of 0.25 to 0.33 at yaw5", _alone("load_friction", "joint:yaw5", 0.25, 0.33)
    ),
}
"""Cases by folder, and what is wanted of them."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: Path
    """Folder of the cases."""
    only: tuple[str, ...] = ()
    """Names of cases; all if none is given."""
    check: bool = False
    """Only check the data, which takes seconds; verdicts are missing then."""
    limit: float = 900.0
    """Seconds after which a diagnosis is stopped."""
    out: Path = Path("runs/field_faults")
    """Folder of the answers of all versions."""
    json: Path | None = None
    """Write all rows here."""


def command_words(case: Case, folder: Path) -> list[str]:
    """Words of the command line: paths of the case in its folder, wildcards as a shell fills them in."""
    out = []
    for word in case.words:
        if word.startswith("--"):
            out.append(word)
        else:
            out += [str(path) for path in sorted(folder.glob(word))] if "*" in word else [str(folder / word)]
    return out


def ask(case: Case, folder: Path, run: Path, config: Config) -> dict[str, Any]:
    """Check and diagnose a case by processes of their own.

    Args:
      case: what is asked.
      folder: of its files.
      run: run folder of the diagnosis.
      config: settings.

    Returns:
      usable, said, result, cpu_seconds, and error, which is the last line of a diagnosis that failed.
    """
    words = [sys.executable, "-m", "btr_mjx.diagnose", *command_words(case, folder)]
    earlier = words.index("--before") if "--before" in words else len(words)  # a check is of one set
    checked = subprocess.run([*words[:earlier], "--check", "--json"], capture_output=True, text=True)
    report: dict[str, Any] = json.loads(checked.stdout) if checked.stdout.strip() else {"usable": False, "findings": []}
    said = "\n".join(finding["message"] for finding in report["findings"])
    answer: dict[str, Any] = {"usable": report["usable"], "said": said, "result": {}, "cpu_seconds": 0.0, "error": ""}
    if not report["usable"] or config.check:
        return answer
    before = _cpu()
    more = ["--out", str(run), "--no-progress", "--no-figures"]
    try:
        done = subprocess.run([*words, *more], capture_output=True, text=True, timeout=config.limit)
        answer["error"] = (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""
    except subprocess.TimeoutExpired:
        answer["error"] = f"no answer within {config.limit:g} s"
    if not answer["error"]:
        answer["result"] = read_json(run / "result.json")
    return answer | {"cpu_seconds": _cpu() - before}


def answered(name: str, config: Config) -> dict[str, Any]:
    """The kept answer to a case, or a new one."""
    case, place = CASES[name], name.replace("/", "_")
    kept = config.out / CODE / f"{place}{'_check' if config.check else ''}.json"
    if not kept.is_file():
        folder = config.cases / name.partition("/")[0]
        if not folder.is_dir():
            raise InputError(f"--cases {config.cases}: there is no folder {folder.name}")
        run = config.out / CODE / place
        write_json(kept, ask(case, folder, run, config))
    return dict(read_json(kept))


def row_of(name: str, kept: Mapping[str, Any]) -> dict[str, Any]:
    """A row of the table."""
    answer = Answer(kept["usable"], kept["said"], kept["result"])
    named = [
        f"{n['effect']}@{n['location']} " + ", ".join(f"{k} {v['value']:.3g}" for k, v in n["parameters"].items())
        for n in answer.result.get("effects", [])
    ]
    got = "; ".join([kept["error"] or answer.verdict, *named])
    right = bool(CASES[name].is_right(answer)) if answer.result or not answer.usable else False
    return {
        "case": name,
        "wanted": CASES[name].wanted,
        "got": got,
        "right": right,
        "cpu_seconds": kept["cpu_seconds"],
        "told": [line for line in answer.result.get("unexplained", [])],
    }


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Entry point."""
    config, rows = tyro.cli(Config, description=__doc__), []
    with cli_errors():
        for unknown in [name for name in config.only if name not in CASES]:
            raise InputError(f"--only: there is no case {unknown}; known are {', '.join(CASES)}")
        for name in config.only or CASES:
            note(f"{name} ...")
            rows.append(row_of(name, answered(name, config)))
            if config.json is not None:
                write_json(config.json, {"code": CODE, "rows": rows})
    for row in rows:
        print(f"{'right' if row['right'] else 'WRONG':6} {row['case']:24} {row['cpu_seconds']:6.0f} CPU-s")
        print(f"       wanted: {row['wanted']}\n       got:    {row['got']}")
        for line in row["told"]:
            print(f"       left:   {line}")
    print(f"{sum(row['right'] for row in rows)} of {len(rows)} right")
    if not all(row["right"] for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
