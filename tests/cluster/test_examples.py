"""The files of examples/cluster do what they say."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tyro
import yaml

from btr_mjx.backtoreality import ScanConfig
from btr_mjx.cluster import check_cluster
from btr_mjx.runs import read_arrays

EXAMPLES = Path(__file__).parents[2] / "examples" / "cluster"

SRUN = """#!/usr/bin/env bash
while [[ $1 == -* ]]; do shift; done
exec "$@" --host 127.0.0.1
"""


@pytest.mark.slow
def test_slurm_script(tmp_path: Path) -> None:
    """With `srun` replaced by one that runs its command here; the second submission resumes."""
    flags = ["--engine=native", "--duration=0.03", "--grid=6", "--trials=4", "--behaviours=random", "--block=6"]
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "srun").write_text(SRUN)
    (tmp_path / "bin" / "srun").chmod(0o755)
    path = os.pathsep.join([str(tmp_path / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "RUN": "run", "SLURM_JOB_ID": "17"}
    command = ["bash", str(EXAMPLES / "slurm.sh"), *flags, "--no-figures", "--no-progress"]

    def submit() -> dict[str, np.ndarray]:
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        assert not list(tmp_path.glob("scheduler-*.json"))
        return read_arrays(tmp_path / "run" / "scan.npz")

    first = submit()
    blocks = sorted((tmp_path / "run" / "blocks").iterdir())
    assert len(blocks) == 4
    shutil.copy(blocks[0], tmp_path)
    blocks[0].unlink()
    again = submit()
    assert blocks[0].read_bytes() == (tmp_path / blocks[0].name).read_bytes()
    np.testing.assert_array_equal(again["fitness"], first["fitness"])


def test_kubernetes_file() -> None:
    parts = list(yaml.safe_load_all((EXAMPLES / "kubernetes.yaml").read_text()))
    kinds = {(part["kind"], part["metadata"]["name"]): part for part in parts}
    assert len(kinds) == len(parts) == 4
    pods = {name: part["spec"]["template"]["spec"] for (kind, name), part in kinds.items() if kind != "Service"}
    containers = {name: pod["containers"][0] for name, pod in pods.items()}
    assert len({container["image"] for container in containers.values()}) == 1
    assert pods["btr-worker"]["nodeSelector"] == pods["btr-scan"]["nodeSelector"]
    assert containers["btr-worker"]["command"][3:7] == ["--nworkers", "1", "--nthreads", "1"]
    words = containers["btr-scan"]["args"][0].partition("$(")[0].split()
    config = tyro.cli(ScanConfig, args=words[3:])
    assert words[:3] == ["python", "-m", "btr_mjx.scan"]
    assert config.cluster is not None
    assert check_cluster(config.cluster)[1] == containers["btr-worker"]["command"][2]
    (service,) = (part for (kind, _), part in kinds.items() if kind == "Service")
    assert config.cluster == f"tcp://{service['metadata']['name']}:{service['spec']['ports'][0]['port']}"
    assert str(config.out).startswith(containers["btr-scan"]["volumeMounts"][0]["mountPath"])
