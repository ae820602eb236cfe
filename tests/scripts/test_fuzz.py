"""The fuzzing command finds what it is for: tracebacks, ended processes and hangs, and keeps their inputs."""

import json
import os
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(__file__).parents[1] / "support" / "odd_parser.py"


def test_outcomes(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, PROGRAM, tmp_path]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120)
    counts = json.loads(done.stdout.splitlines()[-1])
    assert counts == {"accepted": 2, "refused": 2, "traceback": 2, "crash": 2, "hang": 2}
    assert {path.name for path in tmp_path.iterdir()} == {f"odd-0-{i}" for i in (1, 2, 3, 6, 7, 8)}
    assert "KeyError" in (tmp_path / "odd-0-6" / "problem.txt").read_text()
    assert (tmp_path / "odd-0-7" / "a.txt").read_bytes() == b"7"
