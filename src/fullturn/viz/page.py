"""One HTML file that is complete in itself: the frame that all reports share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from string import Template
from typing import Any

import fullturn


def render_page(
    body: str,
    fields: Mapping[str, str],
    *,
    title: str,
    style: str = "",
    script: str = "",
    scene: Any = None,
) -> str:
    """The page with a template of its body filled in; it fetches nothing.

    `style` comes after that of all reports. `scene` is what the script draws, as JSON values.
    """
    assets = resources.files("fullturn.viz") / "assets"
    frame = Template((assets / "page.html").read_text(encoding="utf-8"))
    # Inside a script element only "<" could end the data early.
    data = json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c")
    scripts = (
        f'<script type="application/json" id="scene">{data}</script>\n'
        f"<script>\n{script}\n</script>\n"
    )
    return frame.substitute(
        version=fullturn.__version__,
        title=title,
        style=(assets / "report.css").read_text(encoding="utf-8") + style,
        body=Template(body).substitute(fields).removesuffix("\n"),
        script_policy="script-src 'unsafe-inline'; " if script else "",
        scripts=scripts if script else "",
    )
