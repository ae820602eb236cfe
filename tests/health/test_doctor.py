"""Every check with a fault that is played, and the whole command on this machine."""

import json
import os
import shutil
import stat
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from btr_mjx import doctor
from btr_mjx.health import CHECKS, CheckResult, engine_checks, installation_checks
from btr_mjx.health.installation_checks import MARK, check_folder, check_versions, run_engine_checks


@pytest.mark.parametrize(
    ("name", "installed", "state", "expected"),
    [
        ("polars", None, "off", "polars is not installed"),
        ("mujoco-mjx", "3.2.0", "off", "mujoco-mjx 3.2.0, expected"),
        ("mujoco", "4.0.0", "warning", "mujoco 4.0.0, whose solver errs"),
        ("jax", "0.11.2", "off", "jax 0.11.2, expected >=0.12"),
    ],
)
def test_versions(name: str, installed: str | None, state: str, expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert check_versions().state == "ok"
    true = installation_checks.package_version
    monkeypatch.setattr(installation_checks, "package_version", lambda one: installed if one == name else true(one))
    found = check_versions()
    assert (found.state, expected in found.finding) == (state, True)
    assert name in found.remedy
    assert "pip install" in found.remedy


def test_an_old_python_and_a_package_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.python_version", lambda: "3.11.9")
    assert "Python 3.11.9, expected >=3.12" in check_versions().finding

    def absent(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", absent)
    assert check_versions() == CheckResult("off", "btr-mjx is not installed in this environment", "uv sync")


def test_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that does not exist stands for the nearest one above it; nothing is left behind."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": 5 << 30}))
    assert check_folder(tmp_path / "not" / "yet") == CheckResult("ok", f"{tmp_path}: 5.0 GiB free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": 5 << 20}))
    assert check_folder(tmp_path).state == "warning"

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    found = check_folder(tmp_path)
    assert (found.state, "No space left on device" in found.finding, found.remedy) == (
        "off",
        True,
        "choose another --out",
    )
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    assert check_folder(tmp_path / "file").state == "off"


@pytest.mark.parametrize("value", [2e-4, float("nan")])
def test_an_engine_that_differs_is_off(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    differences = {"lanes arm": 1e-7, "mjx arm": value}
    monkeypatch.setattr(engine_checks, "engine_differences", lambda: ("float32", differences))
    found = engine_checks.check_engines()
    assert (found.state, "mjx arm" in found.finding) == ("off", True)
    assert "XLA_FLAGS" in found.remedy
    differences["mjx arm"] = 1e-6
    assert engine_checks.check_engines().state == "ok"
    monkeypatch.setattr(engine_checks, "engine_differences", lambda: ("float64", differences))
    assert engine_checks.check_engines().state == "off"


def test_slow_lanes_are_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_checks, "engine_speeds", lambda: (1e6, 1e5))
    assert engine_checks.check_speed() == CheckResult(
        "ok", "hexapod, steps/s: lanes 1,000,000, native 100,000, ratio 10.0"
    )
    monkeypatch.setattr(engine_checks, "engine_speeds", lambda: (1e5, 1e5))
    assert engine_checks.check_speed().state == "warning"


def test_faults_are_lines_and_codes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1 and a remedy where something is off, also where a check itself fails; 2 for a wrong flag."""
    doctor.main(["--only", "runs", "--json", "--out", str(tmp_path)])
    result = json.loads(capsys.readouterr().out)
    assert result["ok"] is True
    assert [set(check) for check in result["checks"]] == [{"name", "state", "finding", "remedy"}]

    def fail(folder: Path) -> Any:
        raise KeyError("no such\nthing")

    monkeypatch.setattr(installation_checks, "check_folder", fail)
    with pytest.raises(SystemExit, match="1"):
        doctor.main(["--only", "versions", "runs"])
    versions, runs = capsys.readouterr().out.splitlines()
    assert versions.split()[:2] == ["versions", "ok"]
    assert runs.split()[:2] == ["runs", "off"]
    assert "could not be checked (KeyError: 'no such\\nthing') -> " in runs
    with pytest.raises(SystemExit, match="2"):
        doctor.main(["--only", "weather"])
    assert "'weather', expected all, versions" in capsys.readouterr().err


def stand_in(folder: Path, script: str) -> str:
    """An executable in the place of Python."""
    path = folder / "python"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_processes_that_crash_or_hang(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was found before stays; what was not says why."""
    line = MARK + json.dumps({"devices": {"state": "ok", "finding": "1 x cpu", "remedy": ""}})
    monkeypatch.setattr(sys, "executable", stand_in(tmp_path, f"echo noise; echo '{line}'; echo why >&2; kill -ILL $$"))
    found = run_engine_checks(["devices", "speed"])
    assert found["devices"] == CheckResult("ok", "1 x cpu")
    assert found["speed"].state == "off"
    assert "the process was ended by SIGILL: why" in found["speed"].finding
    monkeypatch.setattr(sys, "executable", stand_in(tmp_path, f"echo '{line}'; exec sleep 20"))
    found = run_engine_checks(["devices", "speed"], 0.5)
    assert found["devices"].state == "ok"
    assert "no answer within 0.5 s" in found["speed"].finding


def test_a_wrong_setting_of_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """A real process that cannot import MuJoCo."""
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    found = run_engine_checks(["engines"])["engines"]
    assert "could not be checked (RuntimeError: invalid value for environment variable MUJOCO_GL" in found.finding
    assert "unset MUJOCO_GL" in found.remedy


@pytest.mark.slow
def test_the_whole_command(tmp_path: Path) -> None:
    """Nothing is off here, and no file is left behind but programs in the cache, which the next command uses."""
    (tmp_path / "work").mkdir()
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-m", "btr_mjx.doctor", "--json"]
    done = subprocess.run(
        command, cwd=tmp_path / "work", env=environment, capture_output=True, text=True, timeout=400, check=False
    )
    result = json.loads(done.stdout)
    assert [check for check in result["checks"] if check["state"] == "off"] == []
    assert (done.returncode, done.stderr) == (0, "")
    assert [check["name"] for check in result["checks"]] == list(CHECKS)
    assert list((tmp_path / "work").iterdir()) == []
    assert any((tmp_path / "cache" / "btr_mjx").rglob("*"))
