"""The network itself learns: the paper's loss alone brings a few pairs to nearly no error."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from fullturn.training.loop import Trainer
from fullturn.training.objective import gmcnet_objective
from fullturn.training.pairs import RunPairs
from fullturn.training.ranks import Ranks
from fullturn.training.recipe import load_recipe
from fullturn.training.run import Silence, train
from fullturn.training.validation import Validation

RECIPE = """
[model]
preset = "clean"
[data]
shapes = [{ path = "procedural:20:0" }]
count = 8
batch = 8
sample_points = 256
cloud_points = 192
[loss]
paper = 1.0
[optimizer]
rate = 2e-3
schedule = "constant"
warmup_steps = 10
clip = 1.0
ema = 0.98
[budget]
steps = 140
[validation]
every = 1000
pairs = 1
[machine]
device = "cpu"
threads = 1
"""


@pytest.mark.slow
def test_eight_pairs_are_learned_by_heart(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text(RECIPE)
    config = load_recipe(str(tmp_path / "recipe.toml"))
    device = torch.device("cpu")
    pairs = RunPairs(config.data, config.validation, part="training")
    own = Validation(pairs, count=8, batch=8, ranks=Ranks())
    trainer = Trainer(
        config, gmcnet_objective(config), pairs=pairs, validation=own, total=140,
        out=tmp_path, device=device, ranks=Ranks(),
    )  # fmt: skip
    before = own.score(trainer.average.model, step=0, device=device)
    trainer.run(watcher=Silence(), stop=lambda: False)
    after = own.score(trainer.average.model, step=140, device=device)
    assert before.mean_deg > 30.0
    assert after.mean_deg < 2.0
    assert trainer.cpu_seconds < 120.0


@pytest.mark.parametrize("loss", ["paper=1.0", "correspondence=1.0"])
def test_the_network_itself_resumes_to_the_bit(tmp_path: Path, loss: str) -> None:
    (tmp_path / "recipe.toml").write_text(RECIPE)
    settings = ["data.batch=2", "budget.steps=3", "loss={paper=0.0, cycle=true}", f"loss.{loss}"]
    settings += ["data.sample_points=64", "data.cloud_points=48"]
    config = load_recipe(str(tmp_path / "recipe.toml"), settings)
    train(config, out=tmp_path / "whole")
    part = load_recipe(str(tmp_path / "recipe.toml"), [*settings, "budget.steps=2"])
    train(part, out=tmp_path / "part")
    train(config, out=tmp_path / "part", resume=True)
    last = [
        next((tmp_path / name / "checkpoints").glob("step-*3.safetensors")).read_bytes()
        for name in ("whole", "part")
    ]
    assert last[0] == last[1]
