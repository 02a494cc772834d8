"""`fullturn methods`: what can be asked for with --method."""

from __future__ import annotations


def methods() -> None:
    """List the registration methods."""
    from rich.console import Console
    from rich.table import Table

    from fullturn.methods.registry import DEFAULT
    from fullturn.methods.registry import methods as registered

    table = Table(box=None, pad_edge=False)
    for title in ("name", "what it is", "reference"):
        table.add_column(title, overflow="fold")
    for method in registered():
        name = f"{method.name} (auto)" if method.name == DEFAULT else method.name
        summary = f"{method.summary} [local]" if method.local else method.summary
        if method.missing:
            summary += f' [needs {", ".join(method.missing)}: pip install "fullturn[baselines]"]'
        table.add_row(name, summary.replace("[", r"\["), method.reference.replace("[", r"\["))
    Console().print(table)
    print("\nYour own: --method file.py:Class or package.module:Class")
