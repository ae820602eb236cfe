"""A robot whose programs compile in seconds."""

from btr_mjx.robots import Box, Robot

STEPS = 40
"""Steps of a trial."""
HOPPER = """
<mujoco>
  <option timestep="0.001" iterations="100" tolerance="1e-12"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="base" pos="0 0 {{ height }}">
      <freejoint/>
      <geom type="sphere" size="0.1" density="{{ density }}" friction="0.7"/>
      <body pos="0.1 0 0" euler="0 30 0">
        <joint name="hip" axis="0 1 0.2" damping="0.1"/>
        <geom type="sphere" pos="{{ length }} 0 0" size="0.04" density="{{ density }}" friction="0.7"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="hip" kp="20" kv="0.5"/></actuator>
</mujoco>
"""


def hopper() -> Robot:
    """A ball with a leg: three parameters of the simulation, two of the controller, two points of contact."""
    return Robot(
        name="hopper",
        template=HOPPER,
        template_path="hopper.xml.j2",
        simulation_box=Box(["length", "height", "density"], [0.2, 0.08, 500.0], [0.4, 0.5, 1000.0]),
        controller_box=Box(["amplitude", "phase"], [0.1, 0.0], [1.0, 3.0]),
        signal=lambda c, time, xp: c[0:1] * xp.sin(20.0 * time + c[1:2]),
        nominal=(0.3, 0.1, 800.0),
        base_body="base",
        duration=STEPS * 0.001,
    )
