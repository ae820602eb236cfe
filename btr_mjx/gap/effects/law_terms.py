"""Data types of laws: terms of a dictionary, functions of the state of a joint, see `law_dictionary`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LawState:
    """What a law may depend on, arrays of one shape.

    Attributes:
      q, v: position and velocity of the joint.
      load: force of its actuators.
      time: since the recording began [s].
      other_q, other_v: position and velocity of another joint.
    """

    q: np.ndarray
    v: np.ndarray
    load: np.ndarray
    time: np.ndarray
    other_q: np.ndarray
    other_v: np.ndarray


@dataclass(frozen=True)
class Tried:
    """The number within a term.

    Attributes:
      name: of the number.
      unit: with {x} for the unit of position.
      values: positions (N,) of the joint -> values to try.
      bounds: amplitude of the joint -> range of the number.
    """

    name: str
    unit: str
    values: Callable[[np.ndarray], np.ndarray]
    bounds: Callable[[float], tuple[float, float]]


@dataclass(frozen=True)
class LawTerm:
    """A term of a dictionary.

    Attributes:
      name: of the effect.
      text: each basis function, with {n} for the number within and {o} for the name of the other joint.
      latex: the same in LaTeX.
      units: of each coefficient, with {f} for the unit of force and {x} for that of position.
      basis: state and number -> basis functions.
      variables: what it depends on: "position", "velocity", "load" or "time"; another joint is not among them.
      title: of the force in a sentence, such as "a ripple".
      tried: the number within; None where there is none.
      friction: whether basis functions are those of a friction torque, which acts against the motion.
      coupled: whether it depends on another joint.
    """

    name: str
    text: tuple[str, ...]
    latex: tuple[str, ...]
    units: tuple[str, ...]
    basis: Callable[[LawState, float], Sequence[np.ndarray]]
    variables: tuple[str, ...]
    title: str
    tried: Tried | None = None
    friction: bool = False
    coupled: bool = False

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return ("a", "b", "c", "d")[: len(self.text)]

    def force(self, at: LawState, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Sum of the basis functions; of friction its torque.

        Args:
          at: states.
          values: coefficients, then the number within.
        """
        own = self.basis(at, float(values[-1]))
        return np.sum([c * f for c, f in zip(values, own, strict=False)], axis=0)

    def equation(self, values: Sequence[float] | np.ndarray, other: str = "", latex: bool = False) -> str:
        """The term with its numbers; a sine and a cosine are written as one sine with its phase.

        Args:
          values: coefficients, then the number within.
          other: name of the other joint.
          latex: whether in LaTeX.
        """
        functions = [own.format(n=f"{values[-1]:.3g}", o=other) for own in (self.latex if latex else self.text)]
        coefficients = [float(c) for c in values[: len(functions)]]
        if len(functions) == 2 and functions[0].replace("sin", "cos") == functions[1]:
            phase = float(np.arctan2(coefficients[1], coefficients[0]))
            shifted = f"{functions[0][:-1]} {'+' if phase >= 0 else '-'} {abs(phase):.2g})"
            functions, coefficients = [shifted], [float(np.linalg.norm(coefficients))]
        terms = " ".join(
            f"{'-' if c < 0 else '+'} {abs(c):.3g} {own}" for c, own in zip(coefficients, functions, strict=True)
        )
        terms = terms.removeprefix("+ ").replace("- ", "-", 1) if terms[0] == "-" else terms.removeprefix("+ ")
        if latex:
            return rf"\Delta f = {terms}" if self.friction else rf"\tau = {terms}"
        return (f"Δf = {terms}" if self.friction else f"τ = {terms}").replace("-", "−")
