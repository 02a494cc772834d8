"""Whole runs of a stand-in: the same numbers whatever happens on the way."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from stand_in import RECIPE, Diary, StandIn, squared, stand_in
from torch import Tensor

from fullturn.data.shapes import ProceduralShapes
from fullturn.errors import FullturnError, InputError, ReadError
from fullturn.training.checkpoint import load_state
from fullturn.training.config import BudgetConfig, TrainConfig
from fullturn.training.log import read_log
from fullturn.training.objective import Objective
from fullturn.training.recipe import load_recipe
from fullturn.training.run import Outcome, train

HERE = Path(__file__).parent


def recipe(folder: Path, *settings: str) -> TrainConfig:
    (folder / "stand-in.toml").write_text(RECIPE)
    return load_recipe(str(folder / "stand-in.toml"), settings)


def run(folder: Path, out: str, *settings: str, **options: object) -> Outcome:
    options = {"objective": stand_in, **options}
    return train(recipe(folder, *settings), out=folder / out, **options)  # type: ignore[arg-type]


def rows(out: Path, name: str = "log.csv") -> list[dict[str, str]]:
    return [{k: v for k, v in row.items() if k != "seconds"} for row in read_log(out / name)]


def assert_same_run(one: Path, other: Path) -> None:
    assert (one / "weights.safetensors").read_bytes() == (
        other / "weights.safetensors"
    ).read_bytes()
    assert rows(one) == rows(other)
    assert rows(one, "validation.csv") == rows(other, "validation.csv")
    a, b = load_state(one), load_state(other)
    assert a.weights.keys() == b.weights.keys()
    assert all(torch.equal(a.weights[name], b.weights[name]) for name in a.weights)
    for index, moments in a.optimizer["state"].items():
        assert all(torch.equal(moments[k], b.optimizer["state"][index][k]) for k in moments)


def test_a_run_leaves_weights_a_card_logs_and_curves(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    diary = Diary()
    done = run(tmp_path, "run", watcher=diary)
    out = tmp_path / "run"
    assert done.is_finished
    assert done.step == diary.total == 6
    assert diary.scored == [3, 6]
    assert (out / "loss.png").read_bytes().startswith(b"\x89PNG")
    log = rows(out)
    assert [row["step"] for row in log] == list("123456")
    assert [row["pairs"] for row in log] == ["4", "8", "12", "16", "20", "24"]
    assert [float(row["loss"]) for row in log] == list(diary.losses.values())
    assert load_recipe(str(out / "recipe.toml")) == recipe(tmp_path)
    tensors = load_file(out / "weights.safetensors")
    assert tensors.keys() == StandIn().state_dict().keys()
    with safe_open(out / "weights.safetensors", "pt") as file:
        assert json.loads(file.metadata()["gmcnet"])["neighbors"] == [5, 5, 5]
    card = (out / "weights.md").read_text()
    for word in ("24 pairs in 6 steps", "made by formulas", "commit", "CPU", "rate = 0.01"):
        assert word in card
    assert done.best is not None
    assert f"{done.best.mean_deg:.2f}°" in card


def test_without_matplotlib_all_else_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    notes: list[str] = []
    assert run(tmp_path, "run", note=notes.append).is_finished
    assert "fullturn[viz]" in notes[0]
    assert (tmp_path / "run" / "weights.md").exists()
    assert not (tmp_path / "run" / "loss.png").exists()


def test_the_exported_weights_are_those_with_the_best_score(tmp_path: Path) -> None:
    settings = ("validation.every=1", "optimizer.rate=0.3", 'optimizer.schedule="constant"')
    done = run(tmp_path, "run", *settings)
    scores = {
        int(r["step"]): float(r["mean_deg"]) for r in rows(tmp_path / "run", "validation.csv")
    }
    assert done.best is not None
    assert done.best.mean_deg == min(scores.values())
    assert done.best.step == min(scores, key=scores.__getitem__)
    run(tmp_path, "until", *settings, f"budget.steps={done.best.step}")
    averages = load_state(tmp_path / "until").weights
    run(tmp_path, "still", "optimizer.rate=0.0")
    first = load_state(tmp_path / "still").weights
    for name in ("features.0.weight", "twist.weight"):
        assert torch.equal(first[f"average.{name}"], first[f"model.{name}"])
        assert not torch.equal(averages[f"average.{name}"], first[f"model.{name}"])
        assert not torch.equal(averages[f"average.{name}"], averages[f"model.{name}"])
    for name, tensor in load_file(tmp_path / "run" / "weights.safetensors").items():
        assert torch.equal(tensor, averages[f"average.{name}"])


@pytest.mark.parametrize("stop_after", [1, 2, 3, 5])
def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path, stop_after: int) -> None:
    run(tmp_path, "whole")
    diary = Diary()
    part = run(tmp_path, "part", watcher=diary, stop=lambda: len(diary.losses) >= stop_after - 1)
    assert part == Outcome(stop_after, part.best, False)
    assert not (tmp_path / "part" / "weights.safetensors").exists()
    assert run(tmp_path, "part", resume=True).is_finished
    assert_same_run(tmp_path / "whole", tmp_path / "part")


def test_workers_change_nothing(tmp_path: Path) -> None:
    run(tmp_path, "here")
    run(tmp_path, "there", "machine.workers=2")
    assert_same_run(tmp_path / "here", tmp_path / "there")


KILLED = """
import os, sys
from pathlib import Path
sys.path.insert(0, {here!r})
from stand_in import Diary, stand_in
from fullturn.training.recipe import load_recipe
from fullturn.training.run import train

class Slow(Diary):
    def step(self, step, **told):
        print(step, flush=True)
        if step == 5:
            sys.stdin.read()

train(load_recipe({recipe!r}), out=Path({out!r}), objective=stand_in, watcher=Slow())
"""


def test_a_killed_run_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    run(tmp_path, "whole")
    code = KILLED.format(
        here=str(HERE), recipe=str(tmp_path / "stand-in.toml"), out=str(tmp_path / "killed")
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    for line in child.stdout:
        if line.strip() == "5":
            break
    child.kill()
    child.communicate()
    assert load_state(tmp_path / "killed").step == 4
    with open(tmp_path / "killed" / "log.csv", "a") as stream:
        stream.write("5,20,0,0,0,0,0\n6,24,0.00")  # after the checkpoint, and cut by the end
    run(tmp_path, "killed", resume=True)
    assert_same_run(tmp_path / "whole", tmp_path / "killed")


def test_a_finished_run_can_go_on_for_longer(tmp_path: Path) -> None:
    constant = 'optimizer.schedule="constant"'
    run(tmp_path, "whole", constant, "budget.steps=8")
    run(tmp_path, "more", constant)
    run(tmp_path, "more", constant, "budget.steps=8", resume=True)
    # The first end was validated, too.
    assert rows(tmp_path / "whole") == rows(tmp_path / "more")
    run(tmp_path, "cosine")
    with pytest.raises(InputError, match="expected the 6 steps"):
        run(tmp_path, "cosine", "budget.steps=8", resume=True)


def test_a_folder_belongs_to_one_run(tmp_path: Path) -> None:
    run(tmp_path, "run")
    with pytest.raises(InputError, match="--resume"):
        run(tmp_path, "run")
    with pytest.raises(InputError, match=r"data\.seed, optimizer\.rate"):
        run(tmp_path, "run", "optimizer.rate=0.5", "data.seed=1", resume=True)
    notes: list[str] = []
    run(tmp_path, "new", resume=True, note=notes.append)
    assert "starting at step 0" in notes[0]


def test_a_damaged_checkpoint_is_told(tmp_path: Path) -> None:
    run(tmp_path, "run")
    (path,) = (tmp_path / "run" / "checkpoints").glob("step-*6.safetensors")
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(ReadError, match="isn't the file that was written with it"):
        run(tmp_path, "run", resume=True)


def exploding(config: TrainConfig) -> Objective:
    calls = []

    def loss(*told: object) -> Tensor:
        calls.append(told)
        return squared(*told) * (float("nan") if len(calls) == 4 else 1.0)  # type: ignore[arg-type]

    return Objective(lambda recipe: StandIn(), {"squared": (1.0, loss)})


def test_a_loss_that_is_not_finite_stops_the_run(tmp_path: Path) -> None:
    run(tmp_path, "good", 'optimizer.schedule="constant"', "budget.steps=3")
    with pytest.raises(FullturnError, match=r"the loss isn't finite in step 4") as caught:
        run(tmp_path, "bad", 'optimizer.schedule="constant"', objective=exploding)
    assert "pairs 12 to 15: " in str(caught.value)
    assert ProceduralShapes(1, seed=3).name(0)[:-1] in str(caught.value)
    good, bad = load_state(tmp_path / "good"), load_state(tmp_path / "bad")
    assert bad.step == 3
    assert all(torch.equal(good.weights[name], bad.weights[name]) for name in good.weights)


def test_a_gradient_that_is_not_finite_stops_the_run(tmp_path: Path) -> None:
    def steep(config: TrainConfig) -> Objective:
        def loss(answer: object, *rest: object) -> Tensor:
            return squared(answer, *rest) + (0.0 * answer.T_target_source.sum()).sqrt()  # type: ignore

        return Objective(lambda recipe: StandIn(), {"steep": (1.0, loss)})

    with pytest.raises(FullturnError, match="the gradient isn't finite in step 1"):
        run(tmp_path, "run", objective=steep)
    assert load_state(tmp_path / "run").step == 0


def test_a_budget_of_time(tmp_path: Path) -> None:
    config = dataclasses.replace(
        recipe(tmp_path, 'optimizer.schedule="constant"'), budget=BudgetConfig(seconds=1e-3)
    )
    done = train(config, out=tmp_path / "run", objective=stand_in)
    assert done.is_finished
    assert done.step == 1
    assert done.best is not None  # scored, whenever it ends
    assert (tmp_path / "run" / "weights.md").exists()


def test_seeds_matter_and_leave_the_callers_generator_alone(tmp_path: Path) -> None:
    before = torch.get_rng_state()
    run(tmp_path, "a", "seed=0", "budget.steps=2")
    assert torch.equal(before, torch.get_rng_state())
    run(tmp_path, "b", "seed=1", "budget.steps=2")
    run(tmp_path, "c", "data.seed=1", "budget.steps=2")
    losses = {rows(tmp_path / name)[0]["loss"] for name in "abc"}
    assert len(losses) == 3


SHARED = """
import sys
from pathlib import Path
sys.path.insert(0, {here!r})
from stand_in import StandIn, squared
from fullturn.training.objective import Objective
from fullturn.training.recipe import load_recipe
from fullturn.training.run import train

def steady(config):
    def model(recipe):
        made = StandIn()
        made.dropout.p = 0.0
        return made
    return Objective(model, {{"squared": (1.0, squared)}})

if __name__ == "__main__":
    train(load_recipe({recipe!r}), out=Path(sys.argv[1]), objective=steady)
"""


def test_two_processes_do_what_one_does(tmp_path: Path) -> None:
    recipe(tmp_path)
    script = tmp_path / "shared.py"
    script.write_text(SHARED.format(here=str(HERE), recipe=str(tmp_path / "stand-in.toml")))
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    alone = [sys.executable, str(script), str(tmp_path / "one")]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    both = [*torchrun, "--nproc-per-node", "2", str(script), str(tmp_path / "two")]
    for command in (alone, both):
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
    one, two = (load_state(tmp_path / name) for name in ("one", "two"))
    for name in one.weights:
        torch.testing.assert_close(one.weights[name], two.weights[name], rtol=0, atol=1e-6)
    for a, b in zip(rows(tmp_path / "one"), rows(tmp_path / "two"), strict=True):
        assert float(a["loss"]) == pytest.approx(float(b["loss"]), rel=1e-5)
    scores = [rows(tmp_path / name, "validation.csv") for name in ("one", "two")]
    for a, b in zip(*scores, strict=True):
        assert (a["step"], a["pairs"]) == (b["step"], b["pairs"])
        assert float(a["mean_deg"]) == pytest.approx(float(b["mean_deg"]), rel=1e-4)
    assert "2 processes" in (tmp_path / "two" / "weights.md").read_text()


def test_a_batch_that_cannot_be_shared_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from contextlib import contextmanager

    from fullturn.training import run as module
    from fullturn.training.ranks import Ranks

    @contextmanager
    def three(device: object) -> object:
        yield Ranks(0, 3)

    monkeypatch.setattr(module, "join_ranks", three)
    with pytest.raises(InputError, match="a multiple of 3 processes, got 4"):
        run(tmp_path, "run")


def test_an_interrupt_is_a_wish() -> None:
    from fullturn.training.signals import until_interrupted

    before = signal.getsignal(signal.SIGINT)
    with until_interrupted() as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        end = time.monotonic() + 5.0
        while not stop() and time.monotonic() < end:
            time.sleep(0.001)
        assert stop()
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5.0)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("device", ["cuda:99", "typewriter"])
def test_a_device_that_is_not_there_is_told(tmp_path: Path, device: str) -> None:
    with pytest.raises(InputError, match=r"machine\.device"):
        run(tmp_path, "run", f"machine.device={device!r}")
