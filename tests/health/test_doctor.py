"""Every check with a fault that is played, and the whole command on this machine."""

import errno
import json
import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from btr_mjx import doctor
from btr_mjx.health import CHECKS, CheckResult, HealthSettings, checks, child, folders, machine, programs, versions
from btr_mjx.health.child import MARK
from btr_mjx.health.result import worst
from btr_mjx.health.versions import SLOW_JAXLIB, judge_versions, measure_versions

DEVICES = {"platform": "cpu", "count": 64, "kind": "cpu", "features": "+avx,+avx2,-avx512f"}
HEALTHY = {
    "devices": DEVICES,
    "agreement": {"precision": "float32", "difference": {"hexapod": {"lanes": 5e-7}, "arm": {"lanes": 4e-7}}},
    "speed": {"lanes": 1.2e6, "native": 1.1e5, "cores": 2},
    "cache": {"enabled": True, "folder": None, "hit": True},
    "pictures": {"backend": "egl", "asked": ""},
}
"""Measurements of a machine on which nothing is wrong, by kind of section; the cache's folder is added by a test."""


def play(patch: pytest.MonkeyPatch, kind: str, **changes: Any) -> None:
    """Probes that measure what `HEALTHY` says, with changes in one section, or `error` in the place of its result."""

    def run(sections: list[str], timeout: float) -> dict[str, dict[str, Any]]:
        reports: dict[str, dict[str, Any]] = {}
        for section in sections:
            name = section.split(":")[0]
            changed = HEALTHY[name] | (changes if name == kind else {})
            reports[section] = {"error": changed["error"]} if "error" in changed else {"result": changed}
        return reports

    patch.setattr(checks, "run_probes", run)


def fake(module: Any, name: str, **values: Any) -> Callable[[pytest.MonkeyPatch], None]:
    """A measurement of which some values are replaced."""
    measure = getattr(module, name)
    return lambda patch: patch.setattr(module, name, lambda *given: measure(*given) | values)


def no_locks(patch: pytest.MonkeyPatch) -> None:
    """A network drive without locks."""

    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    patch.setattr("fcntl.flock", refuse)


def full_disk(patch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    patch.setattr(os, "fsync", refuse)


FAULTS: list[tuple[str, Callable[[pytest.MonkeyPatch], None], str]] = [
    ("versions", fake(versions, "measure_versions", jaxlib="0.11.0"), "16 times slower"),
    ("versions", fake(versions, "measure_versions", polars=None), "polars is not installed"),
    ("versions", fake(versions, "measure_versions", **{"mujoco-mjx": "3.2.0"}), "expected ==3.17.0"),
    ("versions", fake(versions, "measure_versions", python="3.11.9"), "expected >=3.12"),
    ("cores", fake(machine, "measure_cores", usable=64, quota=1.5), "quota is 1.5"),
    ("memory", fake(machine, "measure_memory", free=2.0**28), "0.2 GiB free"),
    ("clock", lambda patch: patch.setattr(time, "time", lambda: 3600.0), "1970-01-01T01:00:00"),
    ("runs", full_disk, "No space left on device"),
    ("tmp", lambda patch: patch.setattr(shutil, "disk_usage", lambda _: _usage(10)), "0.0"),
    ("locks", no_locks, "No locks available"),
    ("locks", lambda patch: patch.setattr("fcntl.flock", lambda *_: None), "does not keep others out"),
    ("processor", fake(machine, "measure_processor", machine="x86_64", flags=["avx"]), "no AVX2"),
    ("devices", lambda patch: play(patch, "devices", error="RuntimeError: no backend"), "could not be checked"),
    ("devices", lambda patch: play(patch, "devices", count=0), "no device"),
    ("engines", lambda patch: play(patch, "agreement", difference={"arm": {"lanes": float("nan")}}), "differs"),
    ("engines", lambda patch: play(patch, "agreement", difference={"arm": {"lanes": 2e-4}}), "differs"),
    ("speed", lambda patch: play(patch, "speed", lanes=8e4), "times below"),
    ("cache", lambda patch: play(patch, "cache"), "no folder"),
    ("cache", lambda patch: play(patch, "cache", folder="/nowhere", hit=False), "not found by the next"),
    ("pictures", lambda patch: play(patch, "pictures", error="ImportError: matplotlib"), "could not be checked"),
]
"""Check, the fault that is played, and what its line says."""


def _usage(free: int) -> Any:
    return type("Usage", (), {"free": free})


@pytest.mark.parametrize(("name", "fault", "expected"), FAULTS, ids=[f"{f[0]}-{f[2]}" for f in FAULTS])
def test_faults_are_off(
    name: str,
    fault: Callable[[pytest.MonkeyPatch], None],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line is off, names a remedy and the exit code is 1; without the fault the same check is not off."""
    command = ["--only", name, "--out", str(tmp_path / "runs")]
    play(monkeypatch, "cache", folder=str(tmp_path))
    doctor.main(command)
    assert capsys.readouterr().out.split()[1] in ("ok", "warning")
    fault(monkeypatch)
    with pytest.raises(SystemExit) as exited:
        doctor.main(command)
    assert exited.value.code == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.split()[:2] == [name, "off"]
    assert expected in line
    assert " -> " in line
    assert list(tmp_path.iterdir()) == []


def test_every_check_has_a_fault() -> None:
    assert {name for name, *_ in FAULTS} == set(CHECKS)


@pytest.mark.parametrize("name", CHECKS)
def test_an_unexpected_error_is_a_line(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(settings: HealthSettings) -> CheckResult:
        raise KeyError("no such\nthing")

    monkeypatch.setitem(CHECKS, name, fail)  # type: ignore[arg-type]
    with pytest.raises(SystemExit, match="1"):
        doctor.main(["--only", name])
    assert "could not be checked (KeyError: 'no such\\nthing')" in capsys.readouterr().out


def test_json_and_unknown_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    doctor.main(["--only", "runs", "tmp", "--json", "--out", str(tmp_path)])
    result = json.loads(capsys.readouterr().out)
    assert result["ok"] is True
    assert [check["name"] for check in result["checks"]] == ["runs", "tmp"]
    assert set(result["checks"][0]) == {"name", "state", "finding", "remedy"}
    with pytest.raises(SystemExit, match="2"):
        doctor.main(["--only", "weather"])
    assert "'weather', expected all, versions" in capsys.readouterr().err


def test_versions_installed_here() -> None:
    found = measure_versions()
    assert judge_versions(found).state == "ok"
    for version in SLOW_JAXLIB:
        assert judge_versions(found | {"jaxlib": version}).state == "off"
    assert "uv sync" in judge_versions(found | {"btr-mjx": None}).remedy


@pytest.mark.parametrize(
    ("flags", "features", "state", "text"),
    [
        (["avx2", "avx512f"], "+avx2,+avx512f", "ok", "AVX-512; compiled programs use 512"),
        (["avx2", "avx512f"], "+avx2,-avx512f", "warning", "AVX-512; compiled programs use 256"),
        (["avx2"], "+avx2,-avx512f", "ok", "AVX2; compiled programs use 256"),
        (None, "+avx2,-avx512f", "ok", "AVX2; compiled programs use 256"),
    ],
)
def test_processor(flags: list[str] | None, features: str, state: str, text: str) -> None:
    result = machine.judge_processor({"name": "A", "machine": "x86_64", "flags": flags}, features)
    assert result.state == state
    assert text in result.finding
    arm = machine.judge_processor({"name": "A", "machine": "aarch64", "flags": ["asimd"]}, "+neon")
    assert arm == CheckResult("ok", "A: NEON; compiled programs use 128 bits")


def test_warnings() -> None:
    """What works, but slower or with less, is no fault."""
    busy = {"machine": 4, "usable": 4, "quota": None, "load": 20.0}
    assert machine.judge_cores(busy).state == "warning"
    assert machine.judge_cores(busy | {"load": 1.0, "quota": 3.0}).state == "ok"
    assert machine.judge_memory({"total": 8.0 * 2**30, "free": 1.5 * 2**30}).state == "warning"
    assert machine.judge_memory({"total": 8.0 * 2**30, "free": None}).state == "ok"
    now = machine.EARLIEST + 1e6
    assert machine.judge_clock(now, now + 60).state == "warning"
    assert machine.judge_clock(now, now + 1).state == "ok"
    assert programs.judge_devices(DEVICES, cores=96, accelerator=False).state == "warning"
    assert programs.judge_devices(DEVICES, cores=8, accelerator=True).state == "warning"
    slow = {"lanes": 2e5, "native": 2e4, "cores": 2}
    assert programs.judge_speed(slow, 512).state == "warning"  # a busy machine: both are slow
    assert programs.judge_speed(slow, None).state == "ok"
    assert programs.judge_cache({"enabled": False, "folder": None, "hit": False}, None).state == "warning"
    assert "unset MUJOCO_GL" in programs.judge_pictures({"backend": None, "asked": "osmesa"}).remedy
    assert programs.judge_pictures({"backend": None, "asked": ""}).state == "warning"


def test_worst() -> None:
    fine, less, broken = (CheckResult(state, state, f"mend {state}") for state in ("ok", "warning", "off"))  # type: ignore[arg-type]
    assert worst(fine, less) == less
    assert worst(less, broken, fine, broken) == CheckResult("off", "off; off", "mend off")


def test_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / "not" / "yet" / "there"
    assert folders.nearest_folder(deep) == tmp_path
    assert folders.measure_locks(deep) == {
        "folder": str(tmp_path),
        "supported": True,
        "excludes": True,
        "error": None,
    }
    measured = folders.measure_space(deep)
    assert measured["error"] is None
    assert folders.judge_space(measured | {"free": 500 * 2**20}, "").state == "warning"
    assert folders.judge_space(measured | {"files": 3}, "").state == "off"
    assert list(tmp_path.iterdir()) == []
    file = tmp_path / "file"
    file.write_text("")
    assert folders.judge_space(folders.measure_space(file), "").state == "off"
    monkeypatch.setitem(sys.modules, "fcntl", None)  # Windows
    assert folders.judge_locks(folders.measure_locks(tmp_path)).state == "warning"


def stand_in(folder: Path, script: str) -> str:
    """An executable in the place of Python."""
    path = folder / "python"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_processes_that_crash_or_hang(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was measured before stays; what was not says why."""
    line = MARK + json.dumps({"section": "devices", "result": {"count": 1}})
    monkeypatch.setattr(sys, "executable", stand_in(tmp_path, f"echo noise; echo '{line}'; echo why >&2; kill -ILL $$"))
    reports = child.run_probes(["devices", "speed"], 20)
    assert child.measured(reports, "devices") == {"count": 1}
    with pytest.raises(child.CannotCheck, match="ended by SIGILL: why"):
        child.measured(reports, "speed")
    monkeypatch.setattr(sys, "executable", stand_in(tmp_path, f"echo '{line}'; exec sleep 20"))
    reports = child.run_probes(["devices", "speed"], 0.5)
    assert child.measured(reports, "devices") == {"count": 1}
    assert reports["speed"]["error"] == "no answer within 0.5 s"
    monkeypatch.setattr(sys, "executable", str(tmp_path / "absent"))
    assert "cannot be started" in child.run_probes(["speed"], 1)["speed"]["error"]


def test_a_wrong_setting_of_mujoco(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A real process that cannot import MuJoCo."""
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(SystemExit, match="1"):
        doctor.main(["--only", "pictures"])
    out = capsys.readouterr().out
    assert "could not be checked (RuntimeError: invalid value for environment variable MUJOCO_GL: vulkan)" in out
    assert "unset MUJOCO_GL" in out


@pytest.mark.slow
def test_the_whole_command(tmp_path: Path) -> None:
    """Nothing is off here, and no file is left behind."""
    cache, work, temporary = (tmp_path / name for name in ("cache", "work", "tmp"))
    for folder in (cache, work, temporary):
        folder.mkdir()
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "TMPDIR": str(temporary)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-m", "btr_mjx.doctor", "--json", "--out", "runs"]
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, timeout=300, check=False)
    result = json.loads(done.stdout)
    assert [check for check in result["checks"] if check["state"] == "off"] == []
    assert done.returncode == 0
    assert done.stderr == ""
    assert [check["name"] for check in result["checks"]] == list(CHECKS)
    assert list(work.iterdir()) == list(temporary.iterdir()) == []
    saved = [path.name for path in (cache / "btr_mjx").rglob("*") if path.is_file()]
    assert saved  # the programs that the next command uses
    assert not any("doctor" in name for name in saved)
