"""Commands as functions of time, against quadrature and an ODE solver."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from gap_models import command
from scipy.integrate import solve_ivp

from btr_mjx.errors import InputError
from btr_mjx.gap.simulate import Command, Segments, World, simulate


def lag_by_integration(sent: Command, constants: Sequence[float], times: np.ndarray) -> np.ndarray:
    """T dy/dt = u - y solved numerically, one lag after the other, for every control."""
    y0 = np.concatenate([sent.at(sent.times[0])] * len(constants))

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        stages = y.reshape(len(constants), -1)
        inputs = np.concatenate([sent.at(t)[None], stages[:-1]])
        return ((inputs - stages) / np.array(constants)[:, None]).ravel()

    out = solve_ivp(slope, (sent.times[0], times[-1]), y0, t_eval=times, max_step=2e-3, rtol=1e-8, atol=1e-10)
    return out.y.T.reshape(len(times), len(constants), -1)[:, -1]


@pytest.mark.parametrize(
    ("interpolation", "constants"),
    [("hold", (0.01,)), ("linear", (0.02, 0.02)), ("cubic", (0.01, 0.03)), ("cubic", (0.02, 0.02))],
)
def test_lags_are_exact(interpolation: str, constants: tuple[float, ...]) -> None:
    sent = command(3, interpolation)
    times = np.linspace(sent.times[0], sent.times[-1] + 0.1, 50)
    lagged = sent
    for constant in constants:
        lagged = lagged.filtered(constant)
    tolerance = 2e-2 if interpolation == "hold" else 1e-4  # the solver steps over the jumps
    np.testing.assert_allclose(lagged.at(times), lag_by_integration(sent, constants, times), atol=tolerance)
    np.testing.assert_allclose(lagged.shifted(0.02).at(times + 0.02), lagged.at(times), atol=1e-9)


@pytest.mark.parametrize("lags", [(), ([0.004, 0.0],), ([0.004, 0.0], [0.003, 0.02])])
@pytest.mark.parametrize("delay", [0.0, 0.0033])
def test_step_control_is_mean_of_held_command(lags: Sequence[list[float]], delay: float) -> None:
    sent, length, parts = command(5, "hold"), 0.0017, 2000
    for constants in lags:
        sent = sent.filtered(constants)
    sent = sent.shifted([delay, 0.0])
    starts = np.linspace(sent.times[0] - 0.02, sent.times[-1] + 0.02, 37)
    fine = np.stack([sent.at(starts + (k + 0.5) * length / parts) for k in range(parts)]).mean(0)
    np.testing.assert_allclose(sent.over_step(starts, length), fine, atol=2 * np.ptp(sent.values) / parts)
    smooth = command(5, "cubic").shifted(delay)
    np.testing.assert_array_equal(smooth.over_step(starts, length), smooth.at(starts))
    later = smooth.over_step(starts, length, [0.5, 0.0])
    np.testing.assert_allclose(later[:, 0], smooth.at(starts + 0.5 * length)[:, 0], atol=1e-12)
    np.testing.assert_allclose(later[:, 1], smooth.at(starts)[:, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("integrator", "actuator"),
    [
        ("Euler", '<position joint="j" kp="8" kv="0.1"/>'),
        ("implicitfast", '<position joint="j" kp="8" kv="0.1"/>'),
        ("implicit", '<motor joint="j" gear="2"/>'),
        ("RK4", '<position joint="j" kp="8" kv="0.1"/>'),
        ("Euler", '<position joint="j" kp="8" timeconst="0.05"/>'),
        ("implicitfast", '<intvelocity joint="j" kp="8" actrange="-2 2"/>'),
    ],
)
def test_commands_act_when_integrators_need_them(integrator: str, actuator: str) -> None:
    """At a coarse step, positions are near those of a fine one, and nearer than with commands half a step later."""
    xml = f"""<mujoco><option timestep="0.004" integrator="{integrator}"/><worldbody><body>
      <joint name="j" axis="0 1 0" damping="0.05" stiffness="4"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      </body></worldbody><actuator>{actuator}</actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    times = np.arange(0.0, 3.001, 0.02)
    sent = Command(times, np.sin(4 * times)[:, None] * np.minimum(times, 1)[:, None], "cubic")

    def positions(timestep: float, delay: float = 0.0) -> np.ndarray:
        start = Segments(
            np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)), times[None], (sent.shifted(delay),), np.array([0])
        )
        return simulate([(World.of(model), start)], timestep=timestep)[0][0, :, 0]

    fine = positions(2e-5)
    chosen, early, late = (np.abs(positions(0.004, delay) - fine).mean() for delay in (0.0, -0.002, 0.002))
    assert chosen < 0.35 * min(early, late)


def test_interpolation_and_extrapolation() -> None:
    sent = command(4, "hold")
    np.testing.assert_array_equal(sent.at(sent.times + 1e-9), sent.values)
    for interpolation in ("hold", "linear", "cubic"):
        sent = command(4, interpolation)
        np.testing.assert_allclose(sent.at(sent.times), sent.values, atol=1e-12)
        np.testing.assert_array_equal(sent.at([-1.0, 9.0]), sent.values[[0, -1]])
        late = sent.shifted([0.0, 0.005])
        np.testing.assert_allclose(late.at(sent.times + 0.005 + 1e-12)[:, 1], sent.values[:, 1], atol=1e-8)
        np.testing.assert_allclose(late.at(sent.times)[:, 0], sent.values[:, 0], atol=1e-12)
        only = sent.filtered([0.0, 0.01])
        np.testing.assert_allclose(only.at(sent.times)[:, 0], sent.values[:, 0], atol=1e-12)
    linear = command(4, "linear")
    middle = 0.5 * (linear.times[1:] + linear.times[:-1])
    np.testing.assert_allclose(linear.at(middle), 0.5 * (linear.values[1:] + linear.values[:-1]), atol=1e-12)
    with pytest.raises(InputError, match="interpolation"):
        Command(np.zeros(1), np.zeros((1, 1)), "steps")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="lag"):
        linear.filtered(-0.1)


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_rate_limit_follows_as_fast_as_it_may(interpolation: str) -> None:
    """Against small steps towards the command; a control without a limit stays what it was."""
    sent, length = command(6, interpolation), 2e-6
    if interpolation == "cubic":  # smooth between samples
        grid = np.linspace(0.0, 0.4, 81)
        sent = Command(grid, np.sin(np.stack([30 * grid, 17 * grid**1.5], 1)), interpolation)
    rates = np.array([0.3, np.inf]) * np.abs(np.diff(sent.values, axis=0) / np.diff(sent.times)[:, None]).max()
    limited = sent.rate_limited(rates)
    times = np.arange(sent.times[0], sent.times[-1] + 0.05, length)
    wanted, reached = sent.at(times + 0.5 * length)[:, 0], np.empty(len(times))
    now = sent.values[0, 0]
    for k, there in enumerate(wanted.tolist()):
        now += np.clip(there - now, -rates[0] * length, rates[0] * length)
        reached[k] = now
    tolerance = 1e-3 * np.ptp(sent.values)
    np.testing.assert_allclose(limited.at(times + length)[:, 0], reached, atol=tolerance)
    assert np.abs(wanted - reached).max() > 0.1 * np.ptp(wanted)
    np.testing.assert_allclose(limited.at(times)[:, 1], sent.at(times)[:, 1], atol=1e-12)
    assert (np.abs(np.diff(limited.at(times)[:, 0])) <= rates[0] * length * (1 + 1e-6)).all()


def test_rate_limits_beside_delays_and_lags() -> None:
    sent = command(6, "linear")
    slow = sent.rate_limited(1.0)
    times = np.linspace(sent.times[0], sent.times[-1] + 0.1, 200)
    np.testing.assert_array_equal(sent.filtered(0.02).rate_limited(1.0).at(times), slow.filtered(0.02).at(times))
    np.testing.assert_array_equal(sent.shifted(0.02).rate_limited(1.0).at(times), slow.shifted(0.02).at(times))
    assert sent.rate_limited(1e6) is sent
    with pytest.raises(InputError, match="rate limit"):
        sent.rate_limited(0.0)
