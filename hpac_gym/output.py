"""Text files read with errors of one line, tables, atomic file writes, and files of lines."""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, Self

from hpac_gym.errors import HpacError


class OutputError(HpacError, OSError):
    """A result cannot be written to the requested place."""


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Tell an `OSError` of the block as an `OutputError` that names the file."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from None


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path next to the file of `path`, links followed, which replaces it when the
    block ends and is removed if the block fails.

    Raises:
        OutputError: `path` is a folder or a device, its folder cannot be created or written to, or
            the disk is full.
    """
    target = _file(path)
    with writing(path):
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(**_beside(target))
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(target)
    except OutputError:  # of another file of the block
        raise
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def keep(path: Path, beside: Callable[[Path], Path] = Path) -> None:
    """Move a file, and the one `beside` it, out of the way, to `NAME-1` or the next free number."""
    if not (path.is_file() or beside(path).is_file()):
        return
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(1))
    free = next(new for new in numbered if not (new.exists() or beside(new).exists()))
    for old, new in ((path, free), (beside(path), beside(free))):
        if old.is_file():
            old.rename(new)


def markdown(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    return "\n".join(
        f"| {' | '.join(map(str, line))} |" for line in (head, ["---"] * len(head), *rows)
    )


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file atomically.

    Raises:
        OutputError: As in `replacing`.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


class Lines:
    """A text file that has each line as soon as it is written: complete after ``kill -9``.

    Args:
        path: the file.
        mode: of `open`.

    Raises:
        OutputError: It cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], mode: str = "w") -> None:
        self._path = path
        with writing(path):
            self._file = open(path, mode, encoding="utf-8", buffering=1)  # noqa: SIM115 - by close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, line: str) -> None:
        """Write a line.

        Raises:
            OutputError: The disk is full.
        """
        with writing(self._path):
            self._file.write(line + "\n")

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):  # of a line that was told when it was written
            self._file.close()


def read_text(
    path: Path, what: str, error: Callable[[str], HpacError], encoding: str = "utf-8"
) -> str:
    """Text of a file; if it cannot be read, or is a device or no UTF-8, the error says so and what it is."""
    try:
        if path.is_char_device():  # it may be read without end
            raise OSError(0, "it is a device")
        return path.read_text(encoding=encoding)
    except (OSError, UnicodeDecodeError) as fault:
        reason = fault.strerror if isinstance(fault, OSError) else "not UTF-8 text"
        raise error(f"{what} {path}: {reason}") from None


def file_hash(path: Path, error: Callable[[str], HpacError]) -> str:
    """SHA-256 of a file, in hexadecimal digits; if it cannot be read, the error says so."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as fault:
        raise error(f"cannot read '{path}': {fault.strerror}") from None


def writable_folder(path: Path) -> Path:
    """Create a folder if needed and check that it is writable, so that a long run does not fail at
    its end.

    Raises:
        OutputError: The folder cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise OutputError(f"cannot write to folder '{path}': {error.strerror or error}") from None
    return path


def writable_file(path: Path) -> None:
    """Check that a file can be written, as `writable_folder` does for its folder.

    Raises:
        OutputError: It is a folder or a device, its folder cannot be created or written to, or its
            name is too long.
    """
    target = _file(path)
    writable_folder(target.parent)
    with writing(path), tempfile.NamedTemporaryFile(**_beside(target)):
        pass


def writable_results(path: Path, *names: str) -> None:
    """Check that results in JSON with these names, or a list of them, can be written to a file, and
    that it is new, empty or has such results already.

    Raises:
        OutputError: As in `writable_file`, or the file has something else.
    """
    writable_file(path)
    try:
        held = json.loads(path.read_bytes() or "null") if path.exists() else None
    except (OSError, ValueError, RecursionError):
        held = ()
    held = held[0] if isinstance(held, list) and held else held
    if held is not None and not (isinstance(held, dict) and held.keys() >= {*names}):
        raise OutputError(f"'{path}' exists and has no results: name another file")


def _beside(target: Path) -> dict[str, Any]:
    """Where the temporary file is that becomes a file."""
    return {"prefix": f".{target.stem}-", "suffix": target.suffix, "dir": target.parent}


def _file(path: str | os.PathLike[str]) -> Path:
    """The file that a path names, links followed, if it may be replaced."""
    target = os.path.realpath(path)
    if os.path.exists(target) and not os.path.isfile(target):
        what = "folder" if os.path.isdir(target) else "device"
        raise OutputError(f"cannot write '{path}': it is a {what}")
    return Path(target)
