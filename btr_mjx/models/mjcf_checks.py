"""Checks of MJCF before MuJoCo compiles it: how much it would make, and which files it would open.

A few words of MJCF can ask for any amount of work (`<replicate count="1000000">`) or memory (`<size memory="1T"/>`),
and name any file of the machine. MuJoCo bounds neither.
"""

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from btr_mjx.errors import InputError
from btr_mjx.runs import check_regular, read_text

MAX_ELEMENTS = 10_000
"""Most elements after replication. The time of MuJoCo's compiler grows with their square: 10,000 geoms take 2 s."""

MAX_BODIES = 5_000
"""Most bodies after replication; 4,000 take 1.5 s to compile."""

MAX_DEPTH = 300
"""Deepest nesting of elements."""

MAX_ASSET_BYTES = 512 << 20
"""Largest mesh, height field or texture file [bytes]."""

MAX_MEMORY_BYTES = 4 << 30
"""Largest `<size memory=...>` [bytes]."""

LIMITS: Mapping[str, float] = {
    **dict.fromkeys(("nrow", "ncol", "width", "height"), 16_384),
    **dict.fromkeys(("nkey", "nuserdata", "njmax", "nconmax", "nsample"), 100_000),
    **dict.fromkeys(("nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam"), 1_000),
    **dict.fromkeys(("nuser_tendon", "nuser_actuator", "nuser_sensor"), 1_000),
    **dict.fromkeys(("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"), 10_000),
    **dict.fromkeys(("sdf_iterations", "sdf_initpoints"), 10_000),
    **{"nstack": MAX_MEMORY_BYTES, "octree_maxdepth": 10, "maxhullvert": 1_000_000},
}
"""Largest numbers of attributes that ask for memory or time, by the attribute's name."""

_COUNTED = ("replicate", "composite", "flexcomp")
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50, "E": 1 << 60}


@dataclass
class _Found:
    """What an MJCF file holds."""

    elements: int = 0
    bodies: int = 0
    attached: int = 0
    files: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=lambda: {""})


def check_mjcf(text: str, where: str, folder: Path, inside: Path | None = None) -> list[Path]:
    """Check MJCF of a file `where`, and the MJCF files that it includes, whose names refer to `folder`.

    No named file may lie outside of the folder `inside`; None where the user chose the model.

    Returns:
      The files that it names and that are there, and those that these name.

    Raises:
      InputError: not XML, too many elements, an attribute above its limit, a named file that is a device, too large or
        outside of `inside`.
      DamagedFile: an included file that is not UTF-8.
    """
    total = _scan(text, where)
    waiting, seen = [(total, folder)], set[Path]()
    while waiting:
        found, home = waiting.pop()
        total.folders |= found.folders
        for kind, name in found.files:
            for path in _places(name, total.folders, folder, home, where, inside):
                if path in seen or not path.exists():
                    continue
                seen.add(path)
                if kind not in ("include", "model"):
                    check_regular(path, MAX_ASSET_BYTES)
                    continue
                part = _scan(read_text(path), str(path))
                times = 1 + (total.attached if kind == "model" else 0)
                total.elements += times * part.elements
                total.bodies += times * part.bodies
                _check_counts(total, where)
                waiting.append((part, path.parent))
    _check_counts(total, where)
    return sorted(seen)


def _check_counts(found: _Found, where: str) -> None:
    for count, most, what in (
        (found.elements, MAX_ELEMENTS, "elements"),
        (found.bodies, MAX_BODIES, "bodies"),
    ):
        if count > most:
            raise InputError(f"{where}: the model has {count} {what} after replication; at most {most} are compiled")


def _places(name: str, folders: set[str], folder: Path, home: Path, where: str, inside: Path | None) -> Iterator[Path]:
    """Where MuJoCo may look for a named file."""
    if "\0" in name:
        raise InputError(f"{where}: {name!r} is not a file name")
    homes = {folder, home} | {base / Path(own) for base in (folder, home) for own in folders}
    for base in homes:
        path = Path(os.path.normpath(base / name))
        if inside is not None and not path.is_relative_to(os.path.normpath(inside)):
            raise InputError(f"{where}: names the file {name!r} outside of {inside}; copy it there")
        yield path


def _scan(text: str, where: str) -> _Found:
    """Count elements and collect file names, without building a tree."""
    found, factors = _Found(), [1]

    def start(name: str, attributes: dict[str, str]) -> None:
        factor = factors[-1]
        if name in _COUNTED:
            factor *= max(1, _product(attributes.get("count", "1"), f"{where}: {name} count"))
        factors.append(factor)
        if len(factors) > MAX_DEPTH:
            raise InputError(f"{where}: elements are nested more than {MAX_DEPTH} deep")
        found.elements += factor
        found.bodies += factor if name in ("body", "composite", "flexcomp") else 0
        found.attached += factor if name == "attach" else 0
        if factor > 1:  # else they are bounded by the length of the text
            _check_counts(found, where)
        for key, value in attributes.items():
            if key in LIMITS:
                _check_number(name, key, value, LIMITS[key], where)
            elif key == "memory":
                _check_memory(value, where)
            elif key == "size" and name == "numeric":
                _check_number(name, key, value, 1_000_000, where)
            elif key.startswith("file") and len(key) <= 9:  # file, fileright, filename, ...
                found.files.append((name, value))
            elif key in ("meshdir", "texturedir", "assetdir"):
                found.folders.add(value)

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: factors.pop()
    # Comments are taken out first: MuJoCo's parser allows two hyphens in them, which XML does not.
    plain = re.sub(r"<!--.*?-->", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL)
    try:
        parser.Parse(plain.strip().encode("utf-8"), True)
    except expat.ExpatError as error:
        raise InputError(f"{where}: not well-formed XML: {error}") from None
    except (ValueError, UnicodeEncodeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: not well-formed XML: {error}") from None
    return found


def _product(text: str, what: str) -> int:
    product = 1
    for word in text.split():
        try:
            product *= max(1, int(float(word)))
        except (ValueError, OverflowError):
            raise InputError(f"{what} = {text[:60]!r}: expected whole numbers") from None
    return product


def _check_number(element: str, key: str, text: str, most: float, where: str) -> None:
    for word in text.split():
        try:
            value = float(word)
        except ValueError:
            continue  # MuJoCo names what it does not understand
        if not abs(value) <= most:
            raise InputError(f"{where}: {element} {key} = {text[:60]!r}: at most {most:g} is accepted")


def _check_memory(text: str, where: str) -> None:
    found = re.fullmatch(r"\s*(-?\d+)\s*([KMGTPE]?)B?\s*", text, re.IGNORECASE)
    if found and len(found[1]) < 30 and int(found[1]) * _UNITS[found[2].upper()] <= MAX_MEMORY_BYTES:
        return
    raise InputError(f"{where}: memory = {text[:60]!r}: expected a size such as 100M, at most 4G")
