from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from fullturn.cli.freeze import freeze
from fullturn.data.draw import ProtocolPairs
from fullturn.data.frozen import FrozenPairs
from fullturn.data.protocols import PROTOCOLS
from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import InputError, WriteError

NAME = "modelnet40/noisy/180"


@pytest.fixture
def run():
    app = typer.Typer()
    app.command()(freeze)

    def call(*arguments: str):
        return CliRunner().invoke(app, [*arguments], catch_exceptions=False)

    return call


def made(out: Path, *, protocol: str = NAME, shapes: str = "procedural:3:5") -> list[str]:
    options = {"--protocol": protocol, "--shapes": shapes, "--count": "2", "--seed": "4"}
    return [*(word for option in options.items() for word in option), "--out", str(out)]


def test_it_writes_the_pairs_and_says_their_hash(run, tmp_path):
    out = tmp_path / "pairs.npz"
    done = run(*made(out))
    assert done.exit_code == 0
    frozen = FrozenPairs(out)
    assert f"{out}: 2 pairs of {NAME}" in done.output.replace("\n", "")
    assert frozen.manifest["sha256"] in done.output
    wanted = ProtocolPairs(PROTOCOLS[NAME], ProceduralShapes(3, seed=5), count=2, seed=4)
    assert frozen.pair(1).source.tobytes() == wanted.pair(1).source.tobytes()


def test_pairs_that_are_there_can_be_frozen(run, tmp_path):
    run(*made(tmp_path / "a.npz"))
    done = run("--pairs", str(tmp_path / "a.npz"), "--out", str(tmp_path / "b.npz"))
    assert FrozenPairs(tmp_path / "a.npz").manifest["sha256"] in done.output


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--protocol", NAME],
        ["--shapes", "procedural"],
        ["--protocol", NAME, "--shapes", "procedural", "--pairs", "a.npz"],
        ["--protocol", "all", "--shapes", "procedural"],
        ["--protocol", NAME, "--shapes", "procedural", "--count", "0"],
    ],
)
def test_other_uses_are_wrong(run, tmp_path, options):
    assert run(*options, "--out", str(tmp_path / "pairs.npz")).exit_code == 2
    assert not (tmp_path / "pairs.npz").exists()


def test_known_errors_leave_no_file(run, tmp_path):
    with pytest.raises(WriteError, match=r"\.npz"):
        run(*made(tmp_path / "pairs.txt"))
    with pytest.raises(InputError, match="expected protocols out of"):
        run(*made(tmp_path / "pairs.npz", protocol="modelnet40/180"))
    assert list(tmp_path.iterdir()) == []


def test_it_writes_over_none_of_its_inputs(run, tmp_path):
    out = tmp_path / "pairs.npz"
    run(*made(out))
    content = out.read_bytes()
    for told in (["--pairs", str(out)], ["--protocol", NAME, "--shapes", f"{out}:train"]):
        with pytest.raises(WriteError, match="this is an input"):
            run(*told, "--out", str(out))
    assert out.read_bytes() == content
