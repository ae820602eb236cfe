"""Which effects may be named: the library, some of it, or effects of one's own from a file."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.library import EFFECTS, KNOWN
from btr_mjx.models import nearest_names


def selected_effects(names: Sequence[str]) -> tuple[Effect, ...]:
    """The effects that may be named.

    Args:
      names: "all", names of the library, FILE.py:NAME.

    Raises:
      InputError: a name that the library lacks, with the nearest; a file that holds no effect.
    """
    known = {effect.name: effect for effect in KNOWN}
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


def own_code(names: Sequence[str]) -> bytes:
    """The files of effects of one's own, for `journal.Journal`: what an earlier version of them gave is not theirs."""
    return b"".join(Path(name.rpartition(":")[0]).read_bytes() for name in names if ".py:" in name)


def _own_effect(name: str) -> Effect:
    file, _, attribute = name.rpartition(":")
    spec = importlib.util.spec_from_file_location(Path(file).stem, file)
    if spec is None or spec.loader is None or not Path(file).is_file():
        raise InputError(f"effect {name!r}: there is no file {file}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    effect = getattr(module, attribute, None)
    if not isinstance(effect, Effect):
        raise InputError(f"effect {name!r}: {attribute} in {file} is {type(effect).__name__}, expected an Effect")
    return effect
