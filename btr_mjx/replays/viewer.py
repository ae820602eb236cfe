"""Replays in MuJoCo's viewer."""

import os
import platform
import time

from btr_mjx.errors import InputError
from btr_mjx.replays.replay_records import Replay


def check_display() -> None:
    """Check that there is a display.

    Raises:
      InputError: there is none.
    """
    if platform.system() == "Linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("--view: there is no display (DISPLAY is not set); leave --view out to write a film")


def view_replay(replay: Replay, slowness: float = 1.0) -> None:
    """Play the motions one after another in MuJoCo's viewer, each again and again until its window is closed.

    Raises:
      InputError: there is no display.
    """
    check_display()
    import mujoco.viewer

    for motion in replay.motions:
        print(f"{motion.title}: {motion.detail} {motion.number}".rstrip(), flush=True)
        data = mujoco.MjData(motion.model)
        with mujoco.viewer.launch_passive(motion.model, data) as viewer:
            while viewer.is_running():
                start = time.monotonic()
                for qpos, moment in zip(motion.qpos, replay.times, strict=True):
                    if not viewer.is_running():
                        break
                    data.qpos[:], data.time = qpos, moment
                    mujoco.mj_forward(motion.model, data)
                    viewer.sync()
                    time.sleep(max(0.0, start + slowness * float(moment) - time.monotonic()))
                time.sleep(1.0)
