"""What the commands with a virtual depth camera call its defects (`fullturn.data.sensor`)."""

from __future__ import annotations

from typing import Annotated

import typer

Noise = Annotated[
    float,
    typer.Option(
        min=0.0, help="Of the depth at a distance of one radius, in radii; grows with depth²."
    ),
]
Quantize = Annotated[
    float, typer.Option(min=0.0, help="Step of the depth at one radius; grows with depth², too.")
]
Grazing = Annotated[
    float,
    typer.Option(min=0.0, max=90.0, metavar="DEG", help="Returns at flatter angles may get lost."),
]
Flying = Annotated[
    float,
    typer.Option(min=0.0, max=1.0, help="Share of edge pixels that land between two surfaces."),
]
Holes = Annotated[int, typer.Option(min=0, help="Random patches without a return.")]
