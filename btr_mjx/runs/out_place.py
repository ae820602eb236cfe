"""Whether a command can write where --out says."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from btr_mjx.errors import InputError


@contextmanager
def writing_to(place: Path, flag: str = "--out") -> Iterator[None]:
    """Errors of the operating system as one that names a place and the flag with which another is chosen.

    Raises:
      InputError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{flag} {place}: cannot be written: {_reason(place, error)}; choose another {flag}") from None


def check_file_place(file: Path, flag: str = "--out") -> None:
    """Check that a file can be written before the work of which it is the result; its folder is made.

    Raises:
      InputError: a folder has that name, or its folder cannot be made or written to.
    """
    if file.is_dir():
        raise InputError(f"{flag} {file}: is a folder; name a file in it")
    with writing_to(file, flag):
        made = not file.exists()
        file.parent.mkdir(parents=True, exist_ok=True)
        file.open("ab").close()
        if made:
            file.unlink()


def _reason(place: Path, error: OSError) -> str:
    """Why nothing can be written: a file in the way is named, with which mkdir fails in several ways."""
    for folder in (place, *place.parents):
        try:
            if folder.exists():
                is_file = not folder.is_dir()
                return f"{folder} is a file" if is_file else f"{folder}: {error.strerror or error}"
        except OSError:
            continue
    return str(error.strerror or error)
