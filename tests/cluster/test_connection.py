"""What --cluster accepts, and one line for whatever it does not."""

import importlib.util
import json
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.cluster import check_cluster, connect
from btr_mjx.cluster.local_worker import share_of
from btr_mjx.cluster.worker_call import (
    DifferentWorker,
    check_environment,
    numerical_environment,
    processor_vectors,
)
from btr_mjx.errors import InputError


def test_forms() -> None:
    assert check_cluster("local:4") == ("local", "4")
    assert check_cluster("tcp://10.0.0.1:8786") == ("address", "tcp://10.0.0.1:8786")
    assert check_cluster("tls://[::1]:8786") == ("address", "tls://[::1]:8786")
    assert check_cluster("file:runs/scheduler.json") == ("file", "runs/scheduler.json")


@pytest.mark.parametrize(
    "text", ["", "local", "local:", "local:0", "local:-1", "local:x", "local:4 ", "tcp://host", "tcp://:8786", "file:"]
)
def test_malformed_text(text: str) -> None:
    with pytest.raises(InputError, match=r"--cluster: got .*expected local:N, tcp://HOST:PORT or file:"):
        check_cluster(text)


def test_dask_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r'pip install "btr-mjx\[cluster\]"'):
        check_cluster("local:2")


def test_nobody_answers(tmp_path: Path) -> None:
    begun = time.monotonic()
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9.*within 1 s"), connect("tcp://127.0.0.1:9", 1.0):
        pass
    with pytest.raises(InputError, match=r"no such file after 0\.2 s"), connect(f"file:{tmp_path / 'none.json'}", 0.2):
        pass
    file = tmp_path / "scheduler.json"
    for text in ("{", "[]", '{"id": 3}'):
        file.write_text(text)
        with pytest.raises(InputError, match="not a scheduler file"), connect(f"file:{file}", 1.0):
            pass
    file.write_text(json.dumps({"address": "tcp://127.0.0.1:9"}))
    with pytest.raises(InputError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9"), connect(f"file:{file}", 1.0):
        pass
    assert time.monotonic() - begun < 30


def test_workers_must_agree_with_the_client() -> None:
    own = numerical_environment(False)
    assert {"btr-mjx", "mujoco", "jax", "jaxlib", "numpy", "python", "processor"} == set(own)
    check_environment(own, "tcp://a:1")
    with pytest.raises(DifferentWorker, match=r"tcp://a:1.*jaxlib .* there, 0\.1 here; processor") as caught:
        check_environment({**own, "jaxlib": "0.1", "processor": "x86_64 with 1024-bit vectors"}, "tcp://a:1")
    assert "\n" not in str(caught.value)
    assert "mujoco" not in str(caught.value)


def test_vector_width() -> None:
    assert processor_vectors("model name: x\nflags\t\t: fpu sse2 avx avx2 avx512f\n") == "512-bit vectors"
    assert processor_vectors("flags : fpu sse2 avx avx2") == "256-bit vectors"
    assert processor_vectors("Features : fp asimd") == "128-bit vectors"
    assert processor_vectors("") == "vectors of unknown width"


@given(st.sets(st.integers(0, 200), min_size=1, max_size=64).map(sorted), st.integers(1, 80))
def test_shares_of_cores(cores: list[int], workers: int) -> None:
    shares = [share_of(cores, index, workers) for index in range(workers)]
    assert all(shares)
    assert set().union(*shares) == set(cores)
    if workers <= len(cores):
        assert sum(map(len, shares)) == len(cores)
        assert max(map(len, shares)) - min(map(len, shares)) <= 1
    else:
        assert {len(share) for share in shares} == {1}
