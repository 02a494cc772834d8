"""Recipes: what is told when they are wrong, and how they are put together."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fullturn.errors import InputError, ReadError
from fullturn.evaluation.paper import paper
from fullturn.nn.config import PRESETS
from fullturn.training.config import BudgetConfig, OptimizerConfig, TrainConfig
from fullturn.training.recipe import family, load_recipe
from fullturn.training.strict import from_table, to_table, to_toml

RECIPES = Path(__file__).parents[2] / "recipes"
FAMILY = str(RECIPES / "modelnet40.toml")


def write(folder: Path, text: str, name: str = "recipe.toml") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '[data]\nbach = 8\nbatch = 0\n[model]\nneighbors = [1, 2]\n[optimizer]\nrate = "high"\n'
        "[typo]\nx = 1\n",
    )
    with pytest.raises(InputError) as caught:
        load_recipe(path)
    told = str(caught.value)
    assert "data.bach: unknown key; did you mean data.batch?" in told
    assert "model.neighbors: expected 3 values, got 2" in told
    assert "optimizer.rate: expected a number, got 'high'" in told
    assert "[data] batch: expected at least 1, got 0" in told
    assert "typo: unknown key" in told


def test_a_network_that_cannot_be_built_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\[model\].*sampling"):
        load_recipe(write(tmp_path, "[model]\nsampling = [4, 2]\n"))


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("batch", "key=value"),
        ("data batch=1", "key=value"),
        ("data.protocols=['none']", "modelnet40/clean/180"),
        ("data.protocols=['modelnet40/clean/180/unseen']", 'classes = "seen"'),
        ("data.shapes=[]", "at least one place"),
        ("loss.paper=0.0", "weight above 0"),
        ("data.batch=true", "a whole number"),
        ("model.preset=best", "clean"),
        ("model.features=xyz", "ppf, rri, fpfh"),
        ("validation.share=0.9", "0.0 to 0.5"),
        ("budget={seconds=5.0}", "constant"),
    ],
)
def test_a_wrong_setting_is_told(tmp_path: Path, setting: str, told: str) -> None:
    with pytest.raises(InputError, match=re.escape(told)):
        load_recipe(write(tmp_path, ""), [setting])


def test_settings_lie_on_top_of_words_on_top_of_files(tmp_path: Path) -> None:
    write(tmp_path, "seed = 1\n[data]\nbatch = 2\nseed = 5\n", "below.toml")
    path = write(
        tmp_path,
        'extends = "below.toml"\nseed = 2\n[choices]\nsize = ["small", "large"]\n'
        'kind = ["a", "b"]\n[with.large]\ndata.batch = 64\n[with."large,b"]\ndata.batch = 65\n',
    )
    assert load_recipe(path).data.batch == 2
    assert (load_recipe(path).seed, load_recipe(path).data.seed) == (2, 5)
    assert load_recipe(f"{path}:large").data.batch == 64
    assert load_recipe(f"{path}:b,large").data.batch == 65
    assert load_recipe(f"{path}:b,large", ["data.batch=7"]).data.batch == 7
    assert load_recipe(f"{path}:b").name == "recipe-small-b"
    with pytest.raises(InputError, match=r"unknown word huge.*size: small, large"):
        load_recipe(f"{path}:huge")
    with pytest.raises(InputError, match="got small and large"):
        load_recipe(f"{path}:small,large")


def test_files_that_are_no_recipes(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"none\.toml"):
        load_recipe("none.toml")
    with pytest.raises(ReadError, match="expected TOML"):
        load_recipe(write(tmp_path, "a b"))
    with pytest.raises(InputError, match="extends itself"):
        load_recipe(write(tmp_path, 'extends = "recipe.toml"'))


def test_a_preset_is_where_a_model_begins(tmp_path: Path) -> None:
    config = load_recipe(write(tmp_path, '[model]\nfeatures = "rri"\npreset = "noisy"\n'))
    assert config.model.features == "rri"
    assert config.model.neighbors == PRESETS["noisy"].neighbors


@given(
    st.builds(
        TrainConfig,
        name=st.text(max_size=9),
        optimizer=st.builds(
            OptimizerConfig,
            rate=st.floats(0, 1),
            clip=st.none() | st.floats(1e-9, 1e9),
            ema=st.floats(0, 0.9),
        ),
        budget=st.builds(BudgetConfig, steps=st.integers(1, 10**9)),
        model=st.sampled_from(list(PRESETS.values())),
    )
)
def test_a_configuration_survives_its_own_toml(config: TrainConfig) -> None:
    import tomllib

    text = to_toml(to_table(config))
    assert from_table(TrainConfig, tomllib.loads(text), name="") == config


def test_every_combination_of_words_is_a_recipe() -> None:
    names = set()
    for words in itertools.product(*family(FAMILY).values()):
        config = load_recipe(f"{FAMILY}:{','.join(words)}")
        noise, angle, features, given_input, parts, classes, _ = words
        assert config.data.protocols == (f"modelnet40/{noise}/{angle}",)
        assert config.data.classes == ("seen" if classes == "unseen" else "all")
        assert config.model.features == features
        assert config.model.rif_only == (given_input == "only")
        assert config.model.hgm == (parts == "whole")
        assert config.loss.cycle == (noise == "noisy")
        names.add(config.name)
    assert len(names) == 2 * 2 * 2 * 3 * 2 * 4 * 2


def test_presets_of_the_family() -> None:
    noisy = load_recipe(f"{FAMILY}:noisy,unseen,45")
    unseen = load_recipe(f"{FAMILY}:noisy,unseen,180")
    assert noisy.model == PRESETS["noisy"]
    assert unseen.model == PRESETS["noisy-unseen"]
    assert (noisy.optimizer.rate, unseen.optimizer.rate) == (4e-4, 1e-4)
    paper_own = load_recipe(f"{FAMILY}:noisy,paper")
    assert (paper_own.optimizer.rate, paper_own.budget.epochs) == (1e-3, 200.0)


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda path: path.name)
def test_recipes_open_with_what_to_expect(path: Path) -> None:
    head = list(itertools.takewhile(lambda x: x.startswith("#"), path.read_text().splitlines()))
    for word in ("Command:", "Machine:", "Time:", "Expected:"):
        assert any(line.startswith(f"# {word}") for line in head), word
    load_recipe(str(path))


def test_expected_numbers_are_the_papers() -> None:
    protocols = [
        f"modelnet40/{noise}/{angle}{classes}"
        for noise in ("clean", "noisy")
        for angle in (45, 180)
        for classes in ("", "/unseen")
    ]
    known: dict[str, dict[str, str]] = {}
    for table in paper().tables:
        for row in table.rows:
            if table.name != "mvp-rg" and row.label.startswith("GMCNet"):
                words = row.label.removeprefix("GMCNet").strip(" ()").lower()
                for protocol, figures in row.figures.items():
                    told = str(figures["rotation_error_deg"]).rstrip("‡†°")
                    known.setdefault(words, {})[protocol] = told
    label = {"rri": "rri", "fpfh": "fpfh", "ppf": "ppf"}
    label |= {f"{name},only": f"{name} only" for name in label}
    label |= {"ppf,bare": "ppf, no k-nn, tpt or hgm", "ppf,knn": "ppf, k-nn"}
    label |= {"ppf,knn-tpt": "ppf, k-nn + tpt"}
    rows = [line for line in Path(FAMILY).read_text().splitlines() if line.startswith("# E |")]
    assert len(rows) == len(label)
    for line in rows:
        words, *numbers = [cell.strip() for cell in line.removeprefix("# E |").split("|")[:-1]]
        expected = [known[label[words]].get(protocol, "–") for protocol in protocols]
        assert numbers == expected, words
