"""One HTML file that is complete in itself: the frame that all interactive reports share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from string import Template
from typing import Any

import fullturn


def render_page(
    body: str, fields: Mapping[str, str], *, title: str, scene: Any, script: str, style: str = ""
) -> str:
    """The page with a template of its body filled in.

    `scene` is what the script draws, as JSON values; `style` comes after that of all reports.
    """
    assets = resources.files("fullturn.viz") / "assets"
    frame = Template((assets / "page.html").read_text(encoding="utf-8"))
    return frame.substitute(
        version=fullturn.__version__,
        title=title,
        style=(assets / "report.css").read_text(encoding="utf-8") + style,
        body=Template(body).substitute(fields).removesuffix("\n"),
        # Inside a script element only "<" could end the data early.
        scene=json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c"),
        script=script,
    )
