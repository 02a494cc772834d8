"""Write a file whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from fullturn.errors import WriteError, one_line

_NO_PLACE = (OSError, ValueError, RuntimeError)  # ValueError: a zero byte; RuntimeError: link loops


def write_atomic(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Put `content` at `path` by renaming a finished temporary file of the same folder.

    Text is written as UTF-8 with the line ends it has. A reader never sees half a file, and a
    failed write leaves what was there before.

    Raises:
        WriteError: the folder is missing or not writable, or `path` is a folder.
    """
    goal = check_path(path, ())
    data = content.encode() if isinstance(content, str) else content
    temporary: str | None = None
    try:
        # A link keeps pointing where it points: its target is what gets replaced.
        goal = goal.resolve()
        descriptor, temporary = tempfile.mkstemp(prefix=f".{goal.name[:40]}.", dir=goal.parent)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, _mode_of(goal))
        os.replace(temporary, goal)
        temporary = None
    except _NO_PLACE as error:
        raise _cannot_write(path, error) from error
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)


def check_output(path: str | os.PathLike[str], suffixes: tuple[str, ...] = ()) -> Path:
    """Check, before the work is done, that an output can go to `path`; writes nothing that stays.

    Raises:
        WriteError: none of `suffixes` (if any are given), no such folder, a folder itself, or a
            place where no file can be made.
    """
    goal = check_path(path, suffixes)
    try:
        real = goal.resolve()
        with suppress(FileNotFoundError):
            real.stat()  # a name that is too long fails here
        # Where `write_atomic` makes its temporary file, too: a rename asks for no more than that.
        with tempfile.TemporaryFile(dir=real.parent):
            pass
    except _NO_PLACE as error:
        raise _cannot_write(path, error) from error
    return goal


def make_folder(path: str | os.PathLike[str]) -> Path:
    """The folder for outputs, made with its parents where it is missing.

    Raises:
        WriteError: it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise WriteError(
            f"cannot make the folder {one_line(path)}: {reason}; choose another one"
        ) from error
    return folder


def check_path(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """The path, if its suffix is right and its folder is one; whether it can be written is open.

    Raises:
        WriteError: none of `suffixes` (if any are given), no such folder, or a folder itself.
    """
    goal, name = Path(path), one_line(path)
    suffix = goal.suffix.lower()
    if suffixes and suffix not in suffixes:
        raise WriteError(
            f"cannot write {name}: expected a file name that ends in one of "
            f"{', '.join(suffixes)}, found {one_line(suffix) if suffix else 'no suffix'}; "
            "choose one of these"
        )
    try:
        in_folder, is_folder = goal.parent.is_dir(), goal.is_dir()
    except _NO_PLACE as error:
        raise _cannot_write(path, error) from error
    if not in_folder:
        raise WriteError(
            f"cannot write {name}: expected an existing folder, {one_line(goal.parent)} "
            "is none; create it first"
        )
    if is_folder:
        raise WriteError(f"cannot write {name}: it is a folder; add a file name to it")
    return goal


def _cannot_write(path: str | os.PathLike[str], error: Exception) -> WriteError:
    reason = getattr(error, "strerror", None) or one_line(error)
    return WriteError(
        f"cannot write {one_line(path)[:200]}: {reason}; choose a place that can be written"
    )


def _mode_of(goal: Path) -> int:
    # mkstemp makes private files; a new output gets the usual mode, an old one keeps its own.
    if goal.exists():
        return goal.stat().st_mode & 0o777
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask
