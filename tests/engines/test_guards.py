"""Guards against native MuJoCo's collision detection, and what happens to pairs whose guard trips."""

from collections.abc import Callable

import jax
import mujoco
import numpy as np
import pytest
from lanes_models import QUICK, mjcf, plain_box

from btr_mjx.engines import LanesStepper, UnsupportedModel
from btr_mjx.engines.guards.pairs import geom_pairs
from btr_mjx.evaluation import evaluate
from btr_mjx.robots import Box, Robot

SHAPES = {
    "sphere": 'type="sphere" size="0.05"',
    "capsule": 'type="capsule" size="0.03 0.08" margin="0.004"',
    "cylinder": 'type="cylinder" size="0.05 0.06"',
    "ellipsoid": 'type="ellipsoid" size="0.03 0.06 0.1" gap="0.01"',
    "box": 'type="box" size="0.04 0.06 0.09"',
    "mesh": 'type="mesh" mesh="wedge"',
    "capsule2": 'type="capsule" size="0.02 0.1"',
    "box2": 'type="box" size="0.1 0.02 0.05" margin="0.002"',
}
ZOO = f"""<mujoco><asset><mesh name="wedge" vertex="0 0 0 .1 0 0 0 .12 0 0 0 .08 .05 .05 .1"/>
<hfield name="hills" nrow="3" ncol="3" size="0.3 0.3 0.05 0.02" elevation="0 1 0 1 0 1 0 1 0"/></asset><worldbody>
<body mocap="true"><geom name="slope" type="plane" size="1 1 1" pos="0 0 -0.2" zaxis="0.1 0 1"/></body>
<geom type="hfield" hfield="hills" pos="0 0 -0.25"/>
<geom name="step" type="box" size=".1 .1 .02" pos=".2 0 0" euler="10 20 30"/>
{"".join(f'<body name="{n}"><freejoint/><geom name="{n}" mass="0.1" {g}/></body>' for n, g in SHAPES.items())}
</worldbody><contact><exclude body1="sphere" body2="box"/>
<pair geom1="sphere" geom2="step" margin="0.03" gap="0.01"/><pair geom1="slope" geom2="cylinder"/></contact></mujoco>"""


def scattered(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> np.ndarray:
    """Positions (nq, count) of free bodies at random places and orientations in a small room."""
    poses = np.concatenate(
        [rng.uniform(-0.35, 0.35, (count, model.njnt, 3)), rng.normal(size=(count, model.njnt, 4))], 2
    )
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    return poses.reshape(count, model.nq).T


def guarded_contacts(model: mujoco.MjModel, qpos: np.ndarray, guarded: set[tuple[int, int]]) -> np.ndarray:
    """Whether native MuJoCo finds a contact of a guarded pair in each state."""
    data, found = mujoco.MjData(model), np.zeros(qpos.shape[1], bool)
    keys = np.array([g1 * model.ngeom + g2 for pair in guarded for g1, g2 in (pair, pair[::-1])])
    for i in range(qpos.shape[1]):
        data.qpos[:] = qpos[:, i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found[i] = np.isin(data.contact.geom[:, 0] * model.ngeom + data.contact.geom[:, 1], keys).any()
    return found


def tripping(model: mujoco.MjModel) -> tuple[Callable[[np.ndarray], np.ndarray], set[tuple[int, int]]]:
    """A function (nq, C) -> bool (C,) that tells whether guards trip in a step, and the guarded pairs."""
    stepper = LanesStepper(model, guards=True)
    crossed = lambda q: stepper.tripped(  # noqa: E731
        stepper.step({}, stepper.state(q, np.zeros((model.nv, q.shape[1]))), np.zeros((model.nu, q.shape[1])))
    )
    geoms = stepper.geoms
    pairs = {(geoms[i], geoms[j]) for group in stepper.guards for i, j in zip(group.first, group.second, strict=True)}
    pairs |= {(geoms[pair.first], geoms[pair.second]) for pair in stepper.meshes}
    return jax.jit(crossed, compiler_options=QUICK), pairs


@pytest.mark.parametrize(
    ("double", "count"), [(True, 2000), pytest.param(False, 100_000, marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_no_contact_of_a_guarded_pair_goes_unmarked(double: bool, count: int, rng: np.random.Generator) -> None:
    """Crowded rooms, and thinner ones in which most pairs are clear, so that bounds that always trip would fail."""
    model = mujoco.MjModel.from_xml_string(ZOO)
    with jax.enable_x64(double):
        crossed, pairs = tripping(model)
        alarms = clear = 0
        for _ in range(count // 1000):
            qpos = scattered(model, 1000, rng)
            places = qpos.reshape(model.njnt, 7, 1000)
            places[:, :3] *= 1 + 2 * rng.random(1000)
            places[:, 2] += 0.3
            marked = np.asarray(crossed(qpos))
            touching = guarded_contacts(model, qpos, pairs)
            assert not (touching & ~marked).any()
            alarms, clear = alarms + int((marked & ~touching).sum()), clear + int((~touching).sum())
            assert 0.1 < touching.mean() < 0.9
    assert alarms < 0.35 * clear  # meshes and height fields count as boxes


def test_bounds_of_primitive_shapes_are_tight(rng: np.random.Generator) -> None:
    shapes = {n: SHAPES[n] for n in ("sphere", "capsule", "cylinder", "box", "capsule2", "box2")}
    bodies = "".join(f'<body><freejoint/><geom mass="1" {g}/></body>' for g in shapes.values())
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    with jax.enable_x64(True):
        crossed, pairs = tripping(model)
        qpos = scattered(model, 2000, rng)
        marked, touching = np.asarray(crossed(qpos)), guarded_contacts(model, qpos, pairs)
    assert len(pairs) == 12  # those of spheres and capsules are computed
    assert not (touching & ~marked).any()
    assert (marked & ~touching).sum() < 0.02 * (~touching).sum()


def test_hulls_of_meshes_are_told_apart_where_their_boxes_overlap(rng: np.random.Generator) -> None:
    stones = [rng.normal(size=(n, 3)) * size for n, size in ((30, [0.1, 0.2, 0.05]), (12, [0.05, 0.05, 0.3]))]
    assets = "".join(
        f'<mesh name="stone{i}" vertex="{" ".join(map(str, stone.ravel()))}"/>' for i, stone in enumerate(stones)
    )
    bodies = "".join(f'<body><freejoint/><geom type="mesh" mesh="stone{i}"/></body>' for i in range(2))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><asset>{assets}</asset><worldbody>{bodies}</worldbody></mujoco>")
    with jax.enable_x64(True):
        crossed, pairs = tripping(model)
        assert len(pairs) == 1
        qpos = scattered(model, 1000, rng)
        marked, touching = np.asarray(crossed(qpos)), guarded_contacts(model, qpos, pairs)
    assert 50 < touching.sum() < 950
    assert not (touching & ~marked).any()
    assert (marked & ~touching).sum() < 0.05 * (~touching).sum()


def test_a_height_field_is_as_high_as_its_highest_point() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><hfield name="hills" nrow="3" ncol="3" size="1 1 4 0.1" elevation="0 1 0 1 0 1 0 1 0"/></asset>'
        '<worldbody><geom type="hfield" hfield="hills"/><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    model.hfield_data[:] *= 0.25  # hills of 1 m where 4 m would be possible
    qpos = np.zeros((7, 2))
    qpos[2], qpos[3] = (1.12, 1.08), 1
    qpos[0] = 0.0, 1.0
    with jax.enable_x64(True):
        crossed, pairs = tripping(model)
        assert np.asarray(crossed(qpos)).tolist() == [False, True]
    assert guarded_contacts(model, np.array([[1.0, 0, 1.02, 1, 0, 0, 0]]).T, pairs).all()


def test_sizes_and_places_may_differ_between_worlds(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody>"
        + "".join(f'<body><freejoint/><geom name="{n}" type="capsule" size="0.03 0.1" mass="1"/></body>' for n in "ab")
        + '</worldbody><contact><pair geom1="a" geom2="b" solreffriction="0.02 1"/></contact></mujoco>'
    )
    count = 1500
    varied = {name: np.repeat(np.asarray(getattr(model, name), float)[None], count, 0) for name in ("geom_size",)}
    varied["geom_pos"] = 0.1 * rng.normal(size=(count, 2, 3))
    varied["geom_size"] *= rng.uniform(0.5, 1.5, varied["geom_size"].shape)
    qpos = scattered(model, count, rng)
    with jax.enable_x64(True):
        stepper = LanesStepper(model, list(varied), guards=True)
        params = jax.tree.map(lambda x: x[0], stepper.pack({name: x[None] for name, x in varied.items()}))
        state = stepper.state(qpos, np.zeros((model.nv, count)))
        marked = np.asarray(
            stepper.tripped(jax.jit(stepper.step, compiler_options=QUICK)(params, state, np.zeros((0, count))))
        )
    model.geom_sameframe[:] = 0
    data, touching = mujoco.MjData(model), np.zeros(count, bool)
    for i in range(count):
        for name, x in varied.items():
            getattr(model, name)[:] = x[i]
        model.geom_rbound[:] = model.geom_size[:, :2].sum(1)
        model.geom_aabb[:, 3:] = model.geom_rbound[:, None]
        data.qpos[:] = qpos[:, i]
        mujoco.mj_forward(model, data)
        touching[i] = data.ncon > 0
    assert 10 < touching.sum() < count - 10
    assert not (touching & ~marked).any()
    assert (marked & ~touching).sum() <= 2


def test_pairs_that_cannot_meet_have_no_guard() -> None:
    arm = '<body name="{0}" pos="{1} 0 0"><joint/><geom name="{0}" size=".1"/>{2}</body>'
    text = (
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><geom name="wall" type="box" size="1 1 1"/>'
        + arm.format(
            "a", 0, arm.format("b", 1, '<body><geom name="welded" size=".1"/></body>' + arm.format("c", 1, ""))
        )
        + arm.format("d", 5, "")
        + '</worldbody><contact><exclude body1="a" body2="d"/></contact></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    names = {frozenset((model.geom(p.first).name, model.geom(p.second).name)) for p in geom_pairs(model)}
    moving = {"a", "b", "welded", "c", "d"}
    fixed = {frozenset((f, g)) for f in ("floor", "wall") for g in moving}
    assert names == fixed | {frozenset(p) for p in (("a", "c"), ("b", "d"), ("welded", "d"), ("c", "d"))}


def test_uncomputed_contacts_are_refused_where_nothing_can_take_over() -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(plain_box() + '<geom type="box" size="1 1 1" contype="1"/>'))
    with pytest.raises(UnsupportedModel, match="contact between geoms other than"):
        LanesStepper(model)
    (group,) = LanesStepper(model, guards=True).guards
    assert len(group.first) == 1


CLAPPER = """<mujoco><option timestep="0.002"/><worldbody>
<body pos="-0.2 0 0"><joint name="left" axis="0 1 0" damping="0.5"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.04" mass="{{ m }}"/></body>
<body pos="0.2 0 0"><joint name="right" axis="0 1 0" damping="0.5"/>
  <geom type="box" pos="0 0 -0.15" size="0.04 0.05 0.15" mass="0.4"/></body></worldbody>
<actuator><motor joint="left" gear="3"/><motor joint="right" gear="3"/></actuator></mujoco>"""


def clapper() -> Robot:
    """Two pendulums side by side that strike each other where their motors push them together."""
    return Robot(
        name="clapper",
        template=CLAPPER,
        template_path="clapper.xml.j2",
        simulation_box=Box(["m"], [0.3], [0.6]),
        controller_box=Box(["left", "right"], [-1, -1], [1, 1]),
        signal=lambda c, t, xp: xp.stack([c[0] * xp.cos(3.0 * t), c[1] * xp.cos(3.0 * t)]),
        nominal=(0.4,),
        duration=0.6,
    )


def test_pairs_whose_guard_trips_have_the_answer_of_native() -> None:
    apart, together = [-0.5, 0.5], [-1.0, 1.0]
    robot, s = clapper(), [[0.35], [0.55]]
    controllers = [apart, *([0.3, 0.2 * k] for k in range(-2, 2)), together[::-1], [1.0, -0.8], apart[::-1]]
    fast, exact = (
        evaluate(robot, s, controllers, engine=engine, times=(0.3, 0.6), states=True) for engine in ("lanes", "native")
    )
    assert fast.engine == "lanes"
    assert 2 <= fast.tripped.sum() < fast.tripped.size / 2 + 1
    assert not fast.tripped[:, 0].any() or not fast.tripped[:, -1].any()
    assert not exact.tripped.any()
    assert fast.outcome.qpos is not None
    assert exact.outcome.qpos is not None
    np.testing.assert_array_equal(fast.outcome.qpos[fast.tripped], exact.outcome.qpos[fast.tripped])
    np.testing.assert_allclose(fast.outcome.qpos, exact.outcome.qpos, rtol=0, atol=1e-5)
    # Without contact the tripped pairs would have moved elsewhere: the guard has done something.
    through = np.abs(exact.outcome.qpos[..., 0] - exact.outcome.qpos[..., 1])
    assert through.max() > 0.1
