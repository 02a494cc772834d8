"""Schedule, average, checkpoint and display, each alone."""

from __future__ import annotations

import io
import itertools
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from stand_in import RECIPE
from torch import nn

from fullturn.errors import ReadError
from fullturn.training.average import WeightAverage
from fullturn.training.checkpoint import State, load_state, save_state
from fullturn.training.config import OptimizerConfig
from fullturn.training.display import live_display
from fullturn.training.recipe import load_recipe
from fullturn.training.schedule import learning_rate
from fullturn.training.validation import Score


@given(
    st.sampled_from(["constant", "linear", "cosine"]),
    st.integers(0, 20),
    st.integers(1, 60),
    st.floats(0.0, 1.0),
)
def test_rates_rise_then_fall_between_their_bounds(
    kind: str, warmup: int, total: int, last: float
) -> None:
    config = OptimizerConfig(rate=2.0, schedule=kind, warmup_steps=warmup, final_share=last)  # type: ignore[arg-type]
    rates = [learning_rate(step, config, total=total) for step in range(total)]
    rising, falling = rates[:warmup], rates[warmup:]
    assert rising == sorted(rising)
    assert all(0.0 < rate < 2.0 for rate in rising)
    assert all(a >= b - 1e-12 for a, b in itertools.pairwise(falling))
    if falling:
        assert falling[0] == pytest.approx(2.0)
    if len(falling) > 1 and kind != "constant":
        assert falling[-1] == pytest.approx(2.0 * last)
    if kind == "constant":
        assert set(falling) <= {2.0}


def test_an_average_follows_its_formula() -> None:
    model = nn.Sequential(nn.Linear(2, 2), nn.BatchNorm1d(2))
    average = WeightAverage(model, decay=0.5)
    expected = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    for step in range(1, 9):
        with torch.no_grad():
            for tensor in (*model.parameters(), *model.buffers()):
                tensor.add_(1)
        average.update(step)
        decay = min(0.5, (1 + step) / (10 + step))
        for name, tensor in model.state_dict().items():
            mixed = decay * expected[name] + (1 - decay) * tensor
            expected[name] = mixed if tensor.is_floating_point() else tensor.clone()
    for name, tensor in average.model.state_dict().items():
        torch.testing.assert_close(tensor, expected[name])
    assert not any(parameter.requires_grad for parameter in average.model.parameters())


def test_no_average_is_the_model_itself() -> None:
    model = nn.Linear(2, 2)
    assert WeightAverage(model, decay=0.0).model is model


def a_state(step: int, best: bytes | None = None) -> State:
    model = nn.Linear(2, 2)
    optimizer = torch.optim.Adam(model.parameters())
    model(torch.ones(1, 2)).sum().backward()
    optimizer.step()
    weights = {f"model.{name}": tensor for name, tensor in model.state_dict().items()}
    return State(step, weights, best, optimizer.state_dict(), {"seconds": 1.5, "scores": []})


def test_only_the_newest_state_is_kept(tmp_path: Path) -> None:
    save_state(tmp_path, a_state(1, b"best"))
    second = a_state(2)
    save_state(tmp_path, second)
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == ["step-000000002.pt", "step-000000002.safetensors"]
    loaded = load_state(tmp_path)
    assert loaded.step == 2
    assert loaded.best is None
    assert loaded.record == second.record
    assert all(torch.equal(loaded.weights[name], second.weights[name]) for name in second.weights)
    assert torch.equal(
        loaded.optimizer["state"][0]["exp_avg"], second.optimizer["state"][0]["exp_avg"]
    )


def test_a_write_that_was_cut_leaves_the_state_before(tmp_path: Path) -> None:
    save_state(tmp_path, a_state(1))
    # Killed after the weights of the next state, and in the middle of the rest.
    (tmp_path / "checkpoints" / "step-000000002.safetensors").write_bytes(b"weights")
    (tmp_path / "checkpoints" / ".step-000000002.pt.abc").write_bytes(b"half")
    assert load_state(tmp_path).step == 1
    save_state(tmp_path, a_state(2))
    assert load_state(tmp_path).step == 2


def test_a_checkpoint_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="found none"):
        load_state(tmp_path)
    save_state(tmp_path, a_state(1))
    (tmp_path / "checkpoints" / "step-000000001.pt").write_bytes(b"nonsense")
    with pytest.raises(ReadError, match="cannot read it"):
        load_state(tmp_path)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_display_shows_steps_and_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    (tmp_path / "r.toml").write_text(RECIPE)
    config = load_recipe(str(tmp_path / "r.toml"))
    console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
    with live_display(config, console) as watcher:
        watcher.start(0, total=6)
        for step in (1, 2):
            watcher.step(step, loss=0.5, seconds=step * 1.0, pairs=4 * step)
        watcher.score(Score(2, 4, 12.345, 6.0, 0.0, 0.5), is_best=True)
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert "12.35°" in told or "12.34°" in told
    assert "best so far" in told
    if terminal:
        assert "step 2" in told
        assert "4.0 pairs/s" in told
    monkeypatch.setenv("RANK", "1")
    silent = Console(file=io.StringIO())
    with live_display(config, silent) as watcher:
        watcher.score(Score(2, 4, 1.0, 1.0, 0.0, 0.5), is_best=True)
    assert silent.file.getvalue() == ""  # type: ignore[attr-defined]
