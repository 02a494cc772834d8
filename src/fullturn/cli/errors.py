"""Turn what can go wrong on the command line into one line and an exit code."""

from __future__ import annotations

import functools
import io
import sys
from collections.abc import Callable
from typing import Any

import typer

from fullturn.errors import FullturnError

KNOWN_ERROR, BELOW_MINIMUM, INTERRUPTED = 1, 3, 130


def known_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Make a command end with 1 and one line for a known error, with 130 for Ctrl-C."""

    @functools.wraps(command)
    def guarded(*args: Any, **options: Any) -> Any:
        try:
            result = command(*args, **options)
            if sys.stdout is not None:  # closed by who called
                sys.stdout.flush()
            return result
        except FullturnError as error:
            tell(f"error: {error}")
            raise typer.Exit(KNOWN_ERROR) from None
        except MemoryError as error:
            reason = str(error) or "no more could be had"
            tell(f"error: expected enough memory, {reason}; ask for less, or for fewer workers")
            raise typer.Exit(KNOWN_ERROR) from None
        except BrokenPipeError:
            raise
        except OSError as error:  # files are named by the code that reads or writes them
            sys.stdout = io.StringIO()  # or the interpreter says it again when it ends
            tell(f"error: cannot write the output: {error.strerror or error}")
            raise typer.Exit(KNOWN_ERROR) from None
        except KeyboardInterrupt:
            tell("interrupted")
            raise typer.Exit(INTERRUPTED) from None

    return guarded


def tell(message: str) -> None:
    """Print one line to standard error."""
    print(f"fullturn: {' '.join(message.split())}", file=sys.stderr)
