"""Selection of effects by name: from the library, or user-defined effects from a file."""

from collections.abc import Sequence
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.library import EFFECTS, KNOWN_EFFECTS
from btr_mjx.models import nearest_names
from btr_mjx.runs import load_object


def selected_effects(names: Sequence[str]) -> tuple[Effect, ...]:
    """Effects by name.

    Args:
      names: "all", names of the library, or FILE.py:NAME.

    Returns:
      The effects, each once.

    Raises:
      InputError: an unknown name, or a file without such an effect.
    """
    known = {effect.name: effect for effect in KNOWN_EFFECTS}
    chosen: dict[str, Effect] = {}
    for name in names:
        if name == "all":
            chosen |= {effect.name: effect for effect in EFFECTS}
        elif ".py:" in name:
            own = _own_effect(name)
            chosen[own.name] = own
        elif name in known:
            chosen[name] = known[name]
        else:
            raise InputError(f"effect {name!r} is not in the library; nearest: {nearest_names(name, list(known), 5)}")
    if not chosen:
        raise InputError("effects: got none, expected names of the library or all")
    return tuple(chosen.values())


def custom_effect_code(names: Sequence[str]) -> bytes:
    """Content of the files of user-defined effects, part of the key of `simulate.Journal`."""
    return b"".join(Path(name.rpartition(":")[0]).read_bytes() for name in names if ".py:" in name)


def _own_effect(name: str) -> Effect:
    effect = load_object(name, "effect")
    if not isinstance(effect, Effect):
        raise InputError(f"effect {name!r}: got {type(effect).__name__}, expected an Effect")
    return effect
