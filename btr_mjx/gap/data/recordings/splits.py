"""Which recordings are fitted and which are held out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.recordings.recording import MIN_SAMPLES, Recording, Split


def assign_splits(recordings: Sequence[Recording], given: Sequence[Any], where: str) -> list[Recording]:
    """Assign recordings to fit or test, by what the dataset says of each: "fit", "test" or None.

    Returns:
      The recordings with their split. If no split is given, the last third of the recordings is held out; a single
      recording is cut at two thirds of its duration. If only some are given, the others are "fit".

    Raises:
      InputError: another value, all recordings in one split, or a single recording that is too short.
    """
    for i, word in enumerate(given):
        if word not in (None, "fit", "test"):
            raise InputError(f"{where}: [[recording]] {i + 1}: split {word!r}: expected 'fit' or 'test'")
    if any(given):
        words: list[Split] = ["test" if word == "test" else "fit" for word in given]
        if len(set(words)) == 1:
            other = "test" if words[0] == "fit" else "fit"
            raise InputError(
                f"{where}: all {len(words)} recordings are in split {words[0]!r}; mark some of them split = {other!r}, "
                "or leave split out everywhere"
            )
        return [replace(r, split=word) for r, word in zip(recordings, words, strict=True)]
    if len(recordings) > 1:
        count = len(recordings) - max(1, len(recordings) // 3)
        return [replace(r, split="fit" if i < count else "test") for i, r in enumerate(recordings)]
    only = recordings[0]
    cut = int(np.searchsorted(only.time, only.time[0] + 2 / 3 * (only.time[-1] - only.time[0])))
    if min(cut, len(only.time) - cut) < MIN_SAMPLES:
        raise InputError(f"{where}: the only recording is too short to hold out a third of it; add another one")
    return [
        only.part(slice(None, cut), "fit", f"{only.name} (first part)"),
        only.part(slice(cut, None), "test", f"{only.name} (last third)"),
    ]


def split_parts(parts: Sequence[Recording], where: str) -> list[Recording]:
    """Hold out the last third of the samples of the only recording, which is in several parts.

    A part is cut where the last third begins, if both pieces are long enough.
    """
    if len(parts) == 1:
        return assign_splits(parts, [None], where)
    total, done = sum(len(part.time) for part in parts), 0
    found: list[Recording] = []
    for part in parts:
        count = len(part.time)
        cut = round(2 / 3 * total) - done
        done += count
        if min(cut, count - cut) >= max(MIN_SAMPLES, total // 20):
            found.append(part.part(slice(None, cut), "fit", f"{part.name} (first part)"))
            found.append(part.part(slice(cut, None), "test", f"{part.name} (rest)"))
        else:
            found.append(replace(part, split="fit" if 2 * cut >= count else "test"))
    if len({one.split for one in found}) == 1:  # one part has nearly everything
        end = len(found) - 1 if found[0].split == "fit" else 0
        found[end] = replace(found[end], split="test" if end else "fit")
    return found
