"""IMUs of simulated realities measure what MuJoCo's own sensors do."""

import mujoco
import numpy as np
import pytest

from btr_mjx.backtoreality.reality.imu_readings import BIAS, NOISE, imu_readings

XML = """
<mujoco>
  <option timestep="0.00025" gravity="0 0 -9.81"/>
  <worldbody>
    <body pos="0 0 1"><freejoint/>
      <geom type="box" size="0.2 0.1 0.05" mass="1"/>
      <site name="imu" pos="0.1 0.05 0.02" euler="20 30 40"/>
    </body>
  </worldbody>
  <sensor><gyro name="turning" site="imu"/><accelerometer name="pull" site="imu"/></sensor>
</mujoco>"""


@pytest.fixture(scope="module")
def flight() -> tuple[mujoco.MjModel, np.ndarray, np.ndarray, np.ndarray]:
    """A box that tumbles: times, configurations and what its sensors measure, every 2.5 ms."""
    model = mujoco.MjModel.from_xml_string(XML)
    data, rows = mujoco.MjData(model), []
    data.qvel[:] = [0.3, -0.2, 2.0, 3.0, -4.0, 5.0]
    for step in range(4000):
        mujoco.mj_forward(model, data)
        if step % 10 == 0:
            rows.append((data.time, data.qpos.copy(), data.sensordata.copy()))
        mujoco.mj_step(model, data)
    return model, *map(np.array, zip(*rows, strict=True))


def test_readings_are_those_of_the_sensors_with_noise(flight):
    model, times, qpos, sensed = flight
    found = imu_readings(model, times, qpos, np.random.default_rng(0))
    for first, name, kind in ((0, "turning", "gyro"), (3, "pull", "accelerometer")):
        off = np.stack([found[f"{name}/{axis}"] for axis in "xyz"], 1)[1:-1] - sensed[1:-1, first : first + 3]
        assert off.std(0) == pytest.approx(np.full(3, NOISE[kind]), rel=0.2)
        assert (np.abs(off.mean(0)) < 4 * BIAS[kind]).all()


def test_model_without_sensors_has_no_readings(flight):
    _, times, qpos, _ = flight
    plain = mujoco.MjModel.from_xml_string(XML[: XML.index("  <sensor>")] + "</mujoco>")
    assert imu_readings(plain, times, qpos, np.random.default_rng(0)) == {}
