"""Where a command will write, checked before it works."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

PICTURE_SUFFIXES = (".png",)


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
