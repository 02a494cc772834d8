"""`fullturn table RUN [RUN…]`: tables and figures from run folders, beside the paper's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def table(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN…", help="Folders that `evaluate` has written.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for what is written; made if missing.")],
) -> None:
    """Put the methods of one or several runs side by side, with the paper's numbers.

    Writes tables.md, tables.tex, report.html, curves.png and risk_coverage.png.
    """
    from fullturn.cli.render import print_results
    from fullturn.errors import DependencyError
    from fullturn.evaluation.folders import read_runs
    from fullturn.evaluation.layout import LATEX_HEAD, latex, markdown_section
    from fullturn.evaluation.page import render_page
    from fullturn.evaluation.paper_layout import paper_layout
    from fullturn.evaluation.pictures import draw_pictures
    from fullturn.evaluation.tables import full_tables, main_table
    from fullturn.io.atomic import make_folder, write_atomic
    from fullturn.viz.curves import save_curves

    sets = read_runs(runs)
    make_folder(out)

    main = main_table(sets)
    details = [*full_tables(sets), *paper_layout(sets)]
    sections = "\n".join(map(markdown_section, [main, *details]))
    write_atomic(out / "tables.md", f"# Results\n\n{sections}")
    write_atomic(out / "tables.tex", LATEX_HEAD + "\n" + "\n".join(map(latex, [main, *details])))

    pictures = {}
    missing = "the run folders hold no rows of pairs"
    try:
        for stem, figure in draw_pictures(sets).items():
            save_curves(out / f"{stem}.png", figure)
            pictures[stem] = (out / f"{stem}.png").read_bytes()
    except DependencyError as error:
        missing = str(error)
    write_atomic(out / "report.html", render_page([main, *details], pictures, title="Results"))

    print_results(main)
    if not pictures:
        typer.echo(f"No figure was drawn: {missing}")
    typer.echo(f"Open {out / 'report.html'} in a browser; tables.md and tables.tex lie beside it.")
