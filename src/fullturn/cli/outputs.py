"""Where a command will write, checked before it works."""

from __future__ import annotations

from pathlib import Path


def check_outputs(*outputs: tuple[Path | None, tuple[str, ...]]) -> None:
    """Check paths, each with the suffixes it may end in, so that no result is lost; None is none.

    Raises:
        WriteError: a path that can't be written, or that two outputs share.
    """
    from fullturn.errors import WriteError, one_line
    from fullturn.io.atomic import check_output

    seen: set[Path] = set()
    for path, suffixes in outputs:
        if path is None:
            continue
        goal = check_output(path, suffixes).resolve()
        if goal in seen:
            raise WriteError(
                f"cannot write {one_line(path)}: expected a path of its own for each output, got "
                "this one twice; choose another name"
            )
        seen.add(goal)
