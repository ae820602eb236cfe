import json
import subprocess

import numpy as np

from btr_mjx.runs import COMPILER_OPTIONS, describe_environment
from btr_mjx.runs.environment import environment_changes, git_state


def test_environment(tmp_path):
    import jax

    jax.devices()
    now = describe_environment()
    json.dumps(now, allow_nan=False)
    assert now["versions"]["numpy"] == np.__version__
    assert now["versions"]["mujoco"] == now["versions"]["mujoco-mjx"]
    assert now["devices"] == [f"{d.platform}:{d.id} {d.device_kind}" for d in jax.devices()]
    assert environment_changes(now, now) == []
    other = now | {"python": "3.99", "versions": now["versions"] | {"jax": "9"}, "devices": None, "start": "later"}
    before = now["versions"]["jax"]
    assert environment_changes(now, other) == [
        f"python changed from {now['python']} to 3.99",
        f"jax changed from {before} to 9",
    ]


def test_git_state(tmp_path, monkeypatch):
    assert git_state(tmp_path) is None
    git = ["git", "-C", str(tmp_path), "-c", "user.name=x", "-c", "user.email=x@example.org"]
    subprocess.run([*git, "init", "-q"], check=True)
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "a.py").write_text("1")
    assert git_state(tmp_path / "site") is None
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*git, "commit", "-qm", "x", "--no-verify"], check=True)
    state = git_state(tmp_path / "site")
    assert len(state["commit"]) == 40
    assert state["dirty"] is False
    (tmp_path / "site" / "a.py").write_text("2")
    assert git_state(tmp_path / "site")["dirty"] is True
    monkeypatch.setenv("PATH", "")
    assert git_state(tmp_path / "site") is None


def test_options_that_the_package_adds_are_no_change_of_the_environment(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "")
    before = describe_environment()
    monkeypatch.setenv("XLA_FLAGS", COMPILER_OPTIONS)
    assert not environment_changes(before, describe_environment())
    monkeypatch.setenv("XLA_FLAGS", f"--xla_cpu_max_isa=AVX2 {COMPILER_OPTIONS}")
    assert describe_environment()["settings"]["XLA_FLAGS"] == "--xla_cpu_max_isa=AVX2"
