"""What the lanes engine computes, guards and refuses of a model."""

from dataclasses import dataclass
from pathlib import Path

import mujoco

from btr_mjx.engines import possible_contacts, refusals
from btr_mjx.errors import InputError


@dataclass(frozen=True)
class Coverage:
    """How the lanes engine treats a model.

    Attributes:
      computed: names of the geom pairs whose contact is computed.
      guarded: geom pairs whose contact is not computed, each with the reason: a world in which one of them may touch is
        evaluated by native MuJoCo.
      refused: features that are not computed, each with the element that uses it; where there are any, native MuJoCo
        evaluates all worlds.
    """

    computed: tuple[str, ...]
    guarded: tuple[str, ...]
    refused: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """Whether the model as a whole is "refused", "guarded" or "computed"."""
        return "refused" if self.refused else "guarded" if self.guarded else "computed"

    def __str__(self) -> str:
        parts = [("computed contacts", self.computed), ("guarded", self.guarded), ("refused", self.refused)]
        return "\n".join(f"{title} ({len(items)}): {'; '.join(items) or '-'}" for title, items in parts)


def as_model(model: mujoco.MjModel | str | Path) -> mujoco.MjModel:
    """The model, or the one of an MJCF file or MJCF text."""
    if isinstance(model, mujoco.MjModel):
        return model
    text = str(model)
    try:
        return mujoco.MjModel.from_xml_string(text) if "<" in text else mujoco.MjModel.from_xml_path(text)
    except ValueError as error:
        raise InputError(f"model: got {text[:80]!r}, expected an MjModel, an MJCF file or MJCF text: {error}") from None


def coverage(model: mujoco.MjModel | str | Path) -> Coverage:
    """What the lanes engine computes, guards and refuses of a model.

    Args:
      model: an MjModel, the path of an MJCF file or MJCF text.

    Returns:
      The coverage; `str()` of it is a short text.

    Raises:
      InputError: MuJoCo cannot read the model.
    """
    m = as_model(model)
    contacts = possible_contacts(m)
    name = lambda g: m.geom(g).name or f"geom number {g}"  # noqa: E731
    computed = [f"{name(g)} and {name(plane)}" for g, planes in contacts.computed.items() for plane, _ in planes]
    computed += [f"{name(pair.first)} and {name(pair.second)}" for pair in contacts.between]
    return Coverage(tuple(computed), tuple(guarded.reason for guarded in contacts.guarded), tuple(refusals(m)))
