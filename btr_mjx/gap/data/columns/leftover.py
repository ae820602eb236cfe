"""Columns that are left over when names are matched, and can be one column of a model only."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import mujoco

from btr_mjx.gap.data.columns.matching import Matched, Tables
from btr_mjx.gap.data.columns.model_columns import model_columns
from btr_mjx.gap.data.columns.one_column import ModelNames
from btr_mjx.gap.data.columns.required import may_be
from btr_mjx.gap.data.columns.units import stated_unit
from btr_mjx.gap.data.columns.words import kind_of, unknown_words, words

Key = tuple[int, str]
"""Number of a table and name in it."""


def with_leftovers(
    matched: Matched, tables: Tables, model: mujoco.MjModel, unmeasured: Collection[str], units: Mapping[str, str]
) -> Matched:
    """The matches, with columns that can be nothing else than one that is absent.

    Such a column holds the name of the joint or actuator and other words that are unknown, as "alpha_pendulum" does; or
    it names none, but the quantity, as "tau" does where one motor has no command yet. No other column may be it, and it
    may be no other one.
    """
    families, names = model_columns(model), ModelNames.of(model)
    taken = dict(matched.names)
    absent = [
        column
        for column in [*families["qpos"], *families["ctrl"]]
        if column.count("/") == 1 and not {column, column.partition("/")[0]} & set(taken.values())
    ]
    absent = [c for c in absent if not (c.startswith("qpos/") and c.removeprefix("qpos/") in unmeasured)]
    free = [(i, column) for i, (_, own) in enumerate(tables) for column in own if (i, column) not in taken]

    def named(key: Key, target: str) -> bool:
        found = list(names.occurrences(words(stated_unit(key[1])[0])))
        form = max((form for form, _ in found if not all(w.isdigit() for w in form)), key=len, default=())
        own = names.aliases.get(form, (None, None))
        return bool(form) and target.partition("/")[2] == own[target.startswith("ctrl/")]

    def unnamed(key: Key, target: str) -> bool:
        said = words(stated_unit(key[1])[0])
        return not unknown_words(said) and any(kind_of(frozenset(said)))

    def only(fits: Callable[[Key, str], bool]) -> dict[Key, str]:
        near = {
            target: [key for key in free if may_be(key[1], target, model, units.get(key[1])) and fits(key, target)]
            for target in absent
        }
        return {
            keys[0]: target
            for target, keys in near.items()
            if len(keys) == 1 and sum(keys[0] in others for others in near.values()) == 1
        }

    notes = list(matched.notes)
    for fits in (named, unnamed):
        found = only(fits)
        taken |= found
        absent, free = [c for c in absent if c not in found.values()], [key for key in free if key not in found]
        notes += [
            f"assumed: column {column!r} is {target}, as no other one may be; to say something else, name it in "
            "[columns] of dataset.toml"
            for (_, column), target in found.items()
        ]
    return replace(matched, names=taken, notes=notes)
