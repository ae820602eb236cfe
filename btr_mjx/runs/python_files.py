"""Objects of others: of a user's own Python files, named FILE.py:NAME, and of installed packages (entry points)."""

import importlib.util
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError


def load_object(name: str, what: str) -> Any:
    """The object FILE.py:NAME of a Python file, which is run: the user says that it is trusted by naming it.

    It is the same one while the file stays the same. `what` says in messages what it is for.

    Raises:
      InputError: there is no such file, it cannot be run, or it has no such name.
    """
    file, _, attribute = name.rpartition(":")
    path = Path(file)
    if not path.is_file():
        raise InputError(f"{what} {name!r}: there is no file {file}")
    module = _module(str(path.resolve()), path.stat().st_mtime_ns, what)
    if not hasattr(module, attribute):
        raise InputError(f"{what} {name!r}: {file} defines no {attribute!r}")
    return getattr(module, attribute)


def installed_objects[T](group: str, kind: type[T]) -> dict[str, T]:
    """Objects that installed packages offer in an entry point group, by the name of their entry point.

    Raises:
      InputError: an entry point that cannot be loaded, or that is no `kind`.
    """
    found = {}
    for entry in entry_points(group=group):
        who = f"entry point {entry.name} = {entry.value!r} of {entry.dist.name if entry.dist else group}"
        try:
            found[entry.name] = entry.load()
        except Exception as error:
            raise InputError(f"{who}: {type(error).__name__}: {error}; mend or remove that package") from error
        if not isinstance(found[entry.name], kind):
            raise InputError(f"{who}: got {type(found[entry.name]).__name__}, expected a {kind.__name__}")
    return found


@lru_cache(maxsize=32)
def _module(file: str, modified: int, what: str) -> Any:
    spec = importlib.util.spec_from_file_location(Path(file).stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"{what} {file!r}: {type(error).__name__}: {error}") from error
    return module
