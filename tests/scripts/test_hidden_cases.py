"""Hidden cases: the datasets that they write, and agreement of their physics with the library's."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hidden_cases import CaseSettings, case_robot, draw_reality, make_case, physics
from hidden_cases.case_sampling import Draw
from hidden_cases.cases import SHARES
from hidden_cases.motion import Restart, peak_loads
from hidden_cases.motion import simulate_reality as move
from hidden_cases.outside import OUTSIDE, possible_outside
from hidden_cases.physics import HiddenReality

from btr_mjx.errors import InputError
from btr_mjx.gap.data import load, noise_of
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.runs import to_plain

ARM_JOINTS = ["elbow", "wrist", "roll"]
DOG_LEG = ["rr_abduction", "rr_swing", "rr_knee"]
CASES = [
    ("arm", "viscous_damping", "joint:elbow", ["elbow"], {"damping": 0.3}),
    ("arm", "dry_friction", "subtree:lower", ARM_JOINTS, {"torque": 0.1}),
    ("arm", "load_friction", "all", ["yaw", "shoulder", *ARM_JOINTS], {"coefficient": 0.1}),
    ("arm", "stribeck_friction", "joint:elbow", ["elbow"], {"torque": 0.2, "speed": 2.0}),
    ("arm", "armature", "joint:shoulder", ["shoulder"], {"armature": 0.05}),
    ("arm", "joint_stiffness", "joint:elbow", ["elbow"], {"stiffness": 2.0}),
    ("arm", "backlash", "subtree:lower", ARM_JOINTS, {"play": 0.005}),
    ("arm", "actuator_delay", "subtree:lower", ARM_JOINTS, {"delay": 0.007}),
    ("arm", "actuator_lag", "actuator:wrist", ["wrist"], {"time_constant": 0.006}),
    ("arm", "actuator_gain", "actuator:yaw", ["yaw"], {"change": -0.1}),
    ("arm", "torque_limit", "actuator:shoulder", ["shoulder"], {"limit": 8.0}),
    ("arm", "payload", "body:lower", None, {"mass": 0.1, "along": 0.2}),
    ("arm", "link_length", "body:upper", None, {"change": 0.02}),
    ("arm", "air_drag", "world", None, {"density": 500.0}),
    ("quadruped", "joint_offset", "joint:rr_knee", ["rr_knee"], {"offset": 0.02}),
    ("quadruped", "armature", "subtree:rr_hip", DOG_LEG, {"armature": 0.005}),
    ("quadruped", "payload", "body:trunk", None, {"mass": 0.6, "x": 0.06, "y": -0.04, "z": 0.03}),
    ("quadruped", "link_length", "body:fr_shank", None, {"change": 0.006}),
    ("quadruped", "ground_friction", "world", None, {"coefficient": 0.5}),
    ("quadruped", "ground_slope", "world", None, {"x": -0.06, "y": 0.04}),
    ("quadruped", "contact_softness", "world", None, {"time_constant": 0.03}),
    ("quadruped", "constant_force", "body:trunk", None, {"x": -5.0, "y": 8.0, "z": -7.0}),
]
RATE, SPAN = 1000, 30


def add(reality: HiddenReality, effect: str, location: str, joints: list[str] | None, values: dict[str, float]) -> None:
    """Add an effect with the physics of hidden cases."""
    body = location.partition(":")[2]
    if effect == "payload":
        position = [0.0, 0.0, 0.0] if "along" not in values else [values["along"], 0.0, 0.0]
        physics.payload(reality, body, values["mass"], [values.get(c, p) for c, p in zip("xyz", position, strict=True)])
    elif effect == "link_length":
        physics.link_length(reality, body, values["change"])
    elif effect == "ground_friction":
        physics.ground_friction(reality, values["coefficient"] / 0.8)
    elif effect == "contact_softness":
        physics.contact_softness(reality, values["time_constant"] - 0.02)
    elif effect == "constant_force":
        physics.constant_force(reality, body, list(values.values()))
    elif joints is None:
        getattr(physics, effect)(reality, **values)
    else:
        getattr(physics, effect)(reality, joints, **values)


@pytest.mark.parametrize(
    ("robot", "effect", "location", "joints", "values"), [pytest.param(*c, id=f"{c[0]} {c[1]} {c[2]}") for c in CASES]
)
def test_hidden_physics_agree_with_the_library(
    robot: str, effect: str, location: str, joints: list[str] | None, values: dict[str, float]
) -> None:
    """Change of motion by an effect within 30 ms, from the same states: MjSpec and hooks against the library."""
    machine = case_robot(robot)
    model, motion = machine.model, machine.draw_motion(np.random.default_rng(3))
    reality = HiddenReality.of(machine)
    add(reality, effect, location, joints, values)
    rows = move(reality, motion, 0.25, RATE)
    without = move(HiddenReality.of(machine), motion, 0.25, RATE, restart=Restart(rows, SPAN))
    found = {c.name: c for c in candidates(model, Scales.of(model), EFFECTS)}[f"{effect}@{location}"]
    names = [parameter.name for parameter in found.parameters]
    assert sorted(names) == sorted(values)
    worlds = [found.apply(World.of(model), [values[name] for name in names]), World.of(model)]
    for world in worlds:
        world.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    starts = np.arange(4, 8) * SPAN
    dense = np.arange(0.0, 0.3, 5e-4)
    segments = Segments(
        rows["time"][starts],
        rows["qpos"][starts],
        rows["qvel"][starts],
        np.arange(SPAN) / RATE,
        (Command(dense, motion(dense), "cubic"),),
        np.zeros(len(starts), int),
    )
    ours = np.subtract(*simulate([(world, segments) for world in worlds], timestep=1e-4))[..., model.nq :]
    theirs = (rows["qvel"] - without["qvel"])[starts[:, None] + np.arange(SPAN)]
    size = np.abs(theirs).max()
    assert size > 1e-4
    np.testing.assert_allclose(ours, theirs, atol=1e-4 * size)


@pytest.mark.parametrize("verdict", ["none", "effect", "unexplained"])
def test_a_case_is_a_dataset_without_the_truth(tmp_path: Path, verdict: str) -> None:
    truth = make_case(
        tmp_path, 5, "pendulum", CaseSettings(verdict=verdict, recordings=(2, 1), rate=250, noise=2.0, duration=1.0)
    )
    dataset = load(tmp_path)
    assert truth.verdict == verdict
    assert (len(dataset.fit), len(dataset.test)) == (2, 1)
    assert dataset.recordings[0].interpolation == "cubic"
    assert (truth.visible > 0) == (verdict != "none")
    assert bool(truth.effects) == (verdict == "effect")
    assert bool(truth.outside) == (verdict == "unexplained")
    recording = dataset.recordings[0]
    np.testing.assert_allclose(np.diff(recording.time), 1 / 250)
    noise, sigma = noise_of(dataset), case_robot("pendulum").sigma(dataset.model)
    np.testing.assert_allclose(noise.qpos, 2.0 * sigma[0], rtol=0.15)
    np.testing.assert_allclose(noise.qvel, 2.0 * sigma[1], rtol=0.15)
    text = "".join(p.read_text() for p in tmp_path.iterdir() if p.suffix in (".toml", ".xml"))
    assert "unexplained" not in text
    assert json.loads(json.dumps(to_plain(truth)))["verdict"] == verdict


def test_the_seed_decides(tmp_path: Path) -> None:
    def case(name: str, seed: int) -> tuple[object, bytes]:
        truth = make_case(tmp_path / name, seed, "pendulum", CaseSettings(recordings=(1, 1), duration=0.3))
        return truth, (tmp_path / name / "behaviour_01.npz").read_bytes()

    first = case("a", 3)
    assert case("b", 3) == first
    assert case("c", 4)[1] != first[1]


def test_small_errors_everywhere(tmp_path: Path) -> None:
    """Without a missing effect, reality differs from the believed model by the small errors alone."""
    gaps = []
    for background in (0.0, 1.0, 3.0):
        folder = tmp_path / str(background)
        make_case(
            folder,
            1,
            "arm",
            CaseSettings(verdict="none", recordings=(1, 1), noise=1e-6, rate=500, background=background, duration=0.6),
        )
        recording = load(folder).recordings[0]
        believed = HiddenReality.of(case_robot("arm"))
        command = Command(recording.time, recording.ctrl, "cubic")
        clean = move(believed, command.at, 0.5, 500)
        gaps.append(np.abs(clean["qpos"] - recording.qpos[: len(clean["qpos"])]).max())
    assert gaps[0] < 1e-5
    assert 1e-4 < gaps[1] < 0.02
    assert gaps[2] > 1.5 * gaps[1]


def test_two_effects_at_once(tmp_path: Path) -> None:
    truth = make_case(tmp_path, 2, "arm", CaseSettings(verdict="effect", effects=2, recordings=(1, 1), duration=0.4))
    assert len({e.effect for e in truth.effects}) == len({e.location for e in truth.effects}) == 2


@pytest.mark.parametrize("name", ["ground_friction", "contact_softness"])
def test_parameters_of_the_ground_are_absolute_values_of_the_reality(name: str) -> None:
    robot = case_robot("quadruped")
    rng = np.random.default_rng(3)
    motions = [robot.draw_motion(rng)]
    draw = Draw(robot, rng, motions, peak_loads(robot, motions))
    reality, (missing,), _ = draw_reality(draw, "effect", [name], None, background=3.0)
    built = reality.spec.compile()
    has = built.geom_friction[:, 0].max() if name == "ground_friction" else built.geom_solref[:, 0].max()
    (said,) = missing.parameters.values()
    assert said == pytest.approx(float(has), rel=1e-12)


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_effects_outside_the_library(name: str, tmp_path: Path) -> None:
    robot = "quadruped" if name == "bungee" else "arm"
    truth = make_case(
        tmp_path,
        1,
        robot,
        CaseSettings(verdict="unexplained", outside=name, recordings=(1, 1), rate=200, noise=1.0, duration=0.8),
    )
    assert truth.outside.startswith(f"{name} at ")
    assert truth.visible > 10
    assert load(tmp_path).model.nu == case_robot(robot).model.nu


def test_effects_that_a_robot_cannot_have_are_refused() -> None:
    assert "bungee" not in possible_outside(HiddenReality.of(case_robot("arm")))
    assert "crosstalk" not in possible_outside(HiddenReality.of(case_robot("pendulum")))
    with pytest.raises(InputError, match="arm can have viscous_damping"):
        make_case("nowhere", 1, "arm", CaseSettings(verdict="effect", effects=["ground_friction"]))
    with pytest.raises(InputError, match="pendulum can have"):
        make_case("nowhere", 1, "pendulum", CaseSettings(verdict="unexplained", outside="bungee"))


def test_shares_of_verdicts() -> None:
    assert sum(SHARES.values()) == pytest.approx(1)
    assert SHARES["none"] >= 0.2
    assert SHARES["unexplained"] >= 0.15
