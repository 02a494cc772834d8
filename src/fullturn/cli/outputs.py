"""Where a command will write, checked before it works."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from fullturn.viz.canvas import METADATA

PICTURE_SUFFIXES = tuple(METADATA)


def check_outputs(
    *outputs: tuple[Path | None, tuple[str, ...]], inputs: Iterable[Path | None]
) -> None:
    """Check paths, each with the suffixes it may end in, so that nothing is lost; None is none.

    Raises:
        WriteError: a path that can't be written, that two outputs share, or of one of the inputs.
        DependencyError: one is a picture, and matplotlib is missing.
    """
    from fullturn.errors import WriteError, one_line
    from fullturn.io.atomic import check_output
    from fullturn.viz.canvas import check_installed

    read = {path.resolve() for path in inputs if path is not None}
    seen: set[Path] = set()
    for path, suffixes in outputs:
        if path is None:
            continue
        goal = check_output(path, suffixes).resolve()
        if goal in read:
            raise WriteError(
                f"cannot write {one_line(path)}: expected a path of its own for each output, this "
                "is an input, which would be lost; choose another name"
            )
        if goal in seen:
            raise WriteError(
                f"cannot write {one_line(path)}: expected a path of its own for each output, got "
                "this one twice; choose another name"
            )
        seen.add(goal)
        if suffixes == PICTURE_SUFFIXES:
            check_installed()


def check_folder(
    folder: Path,
    names: Collection[str],
    *,
    earlier: Collection[str],
    inputs: Iterable[Path | None] = (),
) -> None:
    """Make a folder for the files `names`, where none is in the way but an `earlier` run's.

    Raises:
        WriteError: a file of that name that isn't one of `earlier`, or as `check_outputs` says.
    """
    from fullturn.errors import WriteError, one_line
    from fullturn.io.atomic import make_folder

    make_folder(folder)
    check_outputs(*((folder / name, ()) for name in names), inputs=inputs)
    others = [name for name in names if name not in earlier and (folder / name).exists()]
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        raise WriteError(
            f"cannot write to {one_line(folder)}: expected a folder of its own, found "
            f"{', '.join(others[:3])}{more}, which no earlier run of this command wrote; choose "
            "another folder with --out"
        )
