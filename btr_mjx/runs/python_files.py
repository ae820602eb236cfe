"""Objects of a user's own Python files, named FILE.py:NAME."""

import importlib.util
from functools import lru_cache
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError


def load_object(name: str, what: str) -> Any:
    """An object of a Python file, which is run: the user says that it is trusted by naming it.

    Args:
      name: FILE.py:NAME.
      what: what the object is for, for messages.

    Returns:
      The object; the same one while the file stays the same.

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
