"""Built-in reference signals: sinusoids and splines, with parameters that motors may share.

Both are values that can be compared and hashed, as programs are compiled once per signal. The parameters come first
and the batch last, see `robot.Signal`.
"""

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Sinusoids:
    """r_i = centre_i + sign_i (o_i + a_i sin(omega t + phi_i + shift_i)).

    Each index points into the controller's parameters. Motors with equal indices are tied to each other.

    Attributes:
      amplitude: index of a_i, by motor.
      phase: index of phi_i.
      offset: index of o_i, by motor; empty for none.
      frequency: index of the frequency [Hz] that all motors share; -1 where it is `hertz`.
      hertz: fixed frequency [Hz].
      centre: (n_u,) controls at rest.
      sign: (n_u,) 1, or -1 for a mirrored motor.
      shift: (n_u,) fixed phase differences [rad].
    """

    amplitude: tuple[int, ...]
    phase: tuple[int, ...]
    offset: tuple[int, ...]
    frequency: int
    hertz: float
    centre: tuple[float, ...]
    sign: tuple[float, ...]
    shift: tuple[float, ...]

    def __call__(self, controller: Any, time: Any, xp: Any) -> Any:
        """The reference, see `robot.Signal`."""
        hertz = self.hertz if self.frequency < 0 else controller[self.frequency]
        angle = (2 * math.pi) * hertz * time
        wave = _rows(controller, self.amplitude, xp) * xp.sin(
            angle + _rows(controller, self.phase, xp) + _column(self.shift, controller, xp)
        )
        if self.offset:
            wave = wave + _rows(controller, self.offset, xp)
        return _column(self.centre, controller, xp) + _column(self.sign, controller, xp) * wave


@dataclass(frozen=True)
class Spline:
    """A cubic (Catmull-Rom) curve through knots at equal distances in time, one curve per motor.

    Attributes:
      knots: per motor the indices of its knots in the controller.
      duration: time of the last knot [s]; the first is at 0.
      centre: (n_u,) controls that are added.
      sign: (n_u,) 1, or -1 for a mirrored motor.
    """

    knots: tuple[tuple[int, ...], ...]
    duration: float
    centre: tuple[float, ...]
    sign: tuple[float, ...]

    def __call__(self, controller: Any, time: Any, xp: Any) -> Any:
        """The reference, see `robot.Signal`."""
        count = len(self.knots[0])
        place = xp.clip(time * ((count - 1) / self.duration), 0.0, count - 1.0)
        curve = 0.0
        for k in range(-1, count + 1):  # the curve is continued straight on beyond both ends
            weight = _catmull_rom(xp.abs(place - k), xp)
            if k < 0:
                value = 2.0 * self._knot(controller, 0, xp) - self._knot(controller, 1, xp)
            elif k == count:
                value = 2.0 * self._knot(controller, count - 1, xp) - self._knot(controller, count - 2, xp)
            else:
                value = self._knot(controller, k, xp)
            curve = curve + weight * value
        return _column(self.centre, controller, xp) + _column(self.sign, controller, xp) * curve

    def _knot(self, controller: Any, k: int, xp: Any) -> Any:
        return _rows(controller, tuple(motor[k] for motor in self.knots), xp)


def _catmull_rom(distance: Any, xp: Any) -> Any:
    """Weight of a knot at a distance in knots: 1 at 0, 0 at every other knot."""
    near = 1.0 + distance**2 * (1.5 * distance - 2.5)
    far = 2.0 + distance * (distance * (2.5 - 0.5 * distance) - 4.0)
    return xp.where(distance < 1.0, near, xp.where(distance < 2.0, far, 0.0))


def _rows(controller: Any, index: tuple[int, ...], xp: Any) -> Any:
    """Rows of the parameters, one per motor."""
    return xp.stack([controller[i] for i in index])


def _column(values: tuple[float, ...], controller: Any, xp: Any) -> Any:
    """Numbers, one per motor, against the batch."""
    return xp.asarray(values, controller.dtype).reshape(-1, *([1] * (controller.ndim - 1)))
