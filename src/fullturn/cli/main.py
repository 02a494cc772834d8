"""The command line: `fullturn VERB`. Each verb is a module that imports torch only when it runs."""

from __future__ import annotations

import io
import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

import fullturn
from fullturn.cli.errors import INTERRUPTED, known_errors, tell

# Verb → the module that holds a function of that name.
_VERBS = {
    "register": "fullturn.cli.register",
    "fuse": "fullturn.cli.fuse",
    "locate": "fullturn.cli.locate",
    "batch": "fullturn.cli.batch",
    "methods": "fullturn.cli.methods",
    "demo": "fullturn.cli.demo",
    "evaluate": "fullturn.cli.evaluate",
    "table": "fullturn.cli.table",
    "study": "fullturn.cli.study",
    "freeze": "fullturn.cli.freeze",
    "build": "fullturn.cli.build",
    "scan": "fullturn.cli.scan",
    "train": "fullturn.cli.train",
}


class _Command(TyperCommand):
    """A command whose repeatable options take several values: ``--method a b`` says it twice."""

    def parse_args(self, context: Any, arguments: list[str]) -> list[str]:
        repeatable = {name for p in self.params if getattr(p, "multiple", False) for name in p.opts}
        spread: list[str] = []
        option = None  # the repeatable one that the next word may belong to
        for word in arguments:
            # A shell's variable that isn't set? As a path, it would be the current folder.
            if not word or (word.startswith("--") and word.endswith("=")):
                last = word or next(reversed(spread), self.name)
                raise typer.BadParameter(f"expected a value after {last}, got an empty one")
            if word.startswith("-"):
                option = word if word in repeatable else None
            elif option is not None and spread[-1] != option:
                spread.append(option)
            spread.append(word)
        return super().parse_args(context, spread)


def build_app() -> typer.Typer:
    """The application with all its verbs."""
    app = typer.Typer(
        name="fullturn",
        help="Register two partial 3D scans of an object under any pose.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)
    for verb, module in _VERBS.items():
        app.command(verb, cls=_Command)(known_errors(getattr(import_module(module), verb)))
    return app


def main() -> None:
    """Run the command line.

    Exit codes: 0 done, 1 known error (one line on standard error), 2 wrong usage, 3 done but below
    --min-probability, 130 interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that knows no ° shows "?"
    try:
        build_app()()
    except KeyboardInterrupt:
        tell("interrupted")
        sys.exit(INTERRUPTED)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"fullturn {fullturn.__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    pass
