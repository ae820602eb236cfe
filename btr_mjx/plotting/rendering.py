"""Pictures of robots by `mujoco.Renderer`, in a child process.

MuJoCo binds one OpenGL backend when it is imported, and without a display that is one which cannot render. A child gets
another one by the variable MUJOCO_GL; a driver that hangs or crashes takes no run with it.
"""

import contextlib
import functools
import os
import pickle
import platform
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from btr_mjx.plotting.camera import Camera, camera_for
from btr_mjx.runs import note

TIMEOUT, FRAME_TIMEOUT = 60.0, 2.0
"""Time after which a child counts as failed: for its start, and more for each picture [s]."""


def render(
    motions: Sequence[tuple[mujoco.MjModel, np.ndarray]],
    width: int,
    height: int,
    camera: Camera,
    progress: Callable[[int], object] | None = None,
) -> list[np.ndarray] | None:
    """Render motions of models.

    Args:
      motions: models, and (F, nq) generalised positions of each.
      width: of each picture [pixels].
      height: likewise.
      camera: the view.
      progress: called with the number of pictures done since the last call.

    Returns:
      (F, height, width, 3) uint8 of each motion; None where nothing can be rendered, which one line on stderr says.
    """
    backend = working_backend()
    if backend is None:
        return None
    pictures = _pictures(motions, width, height, camera, backend, progress)
    if pictures is None:
        note("no pictures of robots: rendering failed")
    return pictures


@functools.cache
def working_backend() -> str | None:
    """Value of MUJOCO_GL with which rendering works, None if there is none (reported on stderr).

    Tested once per process: the value set by the user, else EGL, OSMesa and, with a display, GLFW (Linux), or the
    system's default (other systems).
    """
    given = os.environ.get("MUJOCO_GL", "").strip().lower()
    if given in ("disable", "disabled", "off", "false", "0"):
        note(f"no pictures of robots: MUJOCO_GL={given}")
        return None
    tried = [given] if given else ["egl", "osmesa"] if platform.system() == "Linux" else [""]
    if not given and os.environ.get("DISPLAY"):
        tried.append("glfw")
    ball = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
    for backend in tried:
        found = _pictures([(ball, np.zeros((1, 0)))], 32, 32, camera_for([ball], 1.0), backend)
        if found is not None and np.ptp(found[0]) > 0:
            return backend
    names = ", ".join(backend or "the default" for backend in tried)
    hint = "; on Debian: apt install libegl1" if platform.system() == "Linux" else ""
    note(f"no pictures of robots: no OpenGL (tried {names}){hint}")
    return None


def _pictures(
    motions: Sequence[tuple[mujoco.MjModel, np.ndarray]],
    width: int,
    height: int,
    camera: Camera,
    backend: str,
    progress: Callable[[int], object] | None = None,
) -> list[np.ndarray] | None:
    """As `render`, with one backend; None if the child fails."""
    environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
    command = [sys.executable, "-m", "btr_mjx.plotting.render_worker"]
    counts, size = [len(poses) for _, poses in motions], width * height * 3
    frames: list[np.ndarray] = []
    with (
        contextlib.suppress(OSError),
        subprocess.Popen(  # an error of a pipe: the child has ended
            command,
            env=environment | {"MUJOCO_GL": backend},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as child,
    ):
        assert child.stdin is not None
        assert child.stdout is not None
        limit = threading.Timer(TIMEOUT + FRAME_TIMEOUT * sum(counts), child.kill)
        limit.start()
        try:
            pickle.dump((motions, width, height, camera), child.stdin)
            child.stdin.close()
            while len(frame := child.stdout.read(size)) == size:
                frames.append(np.frombuffer(frame, np.uint8).reshape(height, width, 3))
                if progress is not None:
                    progress(1)
        finally:
            limit.cancel()
            child.kill()
    ends = np.cumsum(counts)
    return np.split(np.stack(frames), ends[:-1]) if len(frames) == ends[-1] else None
