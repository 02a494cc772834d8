"""`fullturn methods`: what can be asked for with --method."""

from __future__ import annotations


def methods() -> None:
    """List the registration methods."""
    from rich.console import Console
    from rich.table import Table

    from fullturn.methods.registry import ALIASES
    from fullturn.methods.registry import methods as registered

    table = Table(box=None, pad_edge=False)
    for title in ("name", "what it is", "reference"):
        table.add_column(title, overflow="fold")
    for method in registered():
        also = "".join(f" ({alias})" for alias, home in ALIASES.items() if home == method.name)
        summary = f"{method.summary} [local]" if method.local else method.summary
        if method.missing:
            summary += f' [needs {", ".join(method.missing)}: pip install "fullturn[baselines]"]'
        table.add_row(
            method.name + also, summary.replace("[", r"\["), method.reference.replace("[", r"\[")
        )
    Console().print(table)
    print("\nOther weights: --method gmcnet@WEIGHTS or gmcnet@WEIGHTS+consensus, by name or path")
    print("Your own: --method file.py:Class or package.module:Class")
