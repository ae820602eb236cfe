"""Words for what a hypothesis leaves: one place and unit for every degree of freedom, whatever its joint."""

import mujoco

from btr_mjx.models import dof_places

XML = """<mujoco><worldbody>
<body name="trunk"><freejoint name="root"/><geom size="0.1"/>
  <body name="arm"><joint name="shoulder" type="ball"/><geom size="0.1"/>
    <body name="hand"><joint name="wrist"/><joint name="grip" type="slide"/><geom size="0.1"/></body></body></body>
</worldbody></mujoco>"""


def test_every_degree_of_freedom_has_a_place_and_a_unit() -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    places = dof_places(model)
    assert len(places) == model.nv
    assert [unit for _, unit in places] == 3 * ["N"] + 6 * ["N m"] + ["N m", "N"]
    assert places[0][0] == "body trunk, force along x"
    assert [where for where, _ in places[6:]] == [
        *(f"joint shoulder, torque about {axis}" for axis in "xyz"),
        "joint wrist",
        "joint grip",
    ]
