"""Where a sensor stood, as the option of several verbs."""

from __future__ import annotations

import pytest
import typer

from fullturn.cli.viewpoint import parse_viewpoint


@pytest.mark.parametrize("text", ["0.1,-2,3", "0.1 -2 3", "0.1, -2, 3"])
def test_three_numbers(text: str) -> None:
    assert parse_viewpoint(text, "--viewpoint") == (0.1, -2.0, 3.0)
    assert parse_viewpoint(None, "--viewpoint") is None


@pytest.mark.parametrize("text", ["", "1,2", "1,2,nan", "here"])
def test_anything_else_is_wrong_usage(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="--viewpoint: expected three numbers as in"):
        parse_viewpoint(text, "--viewpoint")
