"""Parts of a page that are written from results, between two marks."""

from __future__ import annotations

import textwrap


def wrapped(text: str, *, indent: str = "") -> str:
    """Text wrapped as the pages are, later lines indented."""
    filled = textwrap.fill(
        text, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return filled + "\n"


def rewrite(page: str, part: str, begin: str, end: str) -> str:
    """The page with another part between the marks."""
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"expected {begin} and, later, {end} in the page; put them back")
    return f"{before}{begin}\n{part}{end}{after}"
