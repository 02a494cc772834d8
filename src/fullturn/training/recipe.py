"""Recipes: TOML files that extend one another and hold a family of runs as words to choose from."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fullturn.errors import InputError, ReadError, one_line
from fullturn.nn.config import PRESETS
from fullturn.training.config import TrainConfig
from fullturn.training.strict import from_table, to_table

# Keys of a recipe file that are no part of the configuration.
_EXTENDS, _CHOICES, _WITH = "extends", "choices", "with"


def load_recipe(spec: str, settings: Sequence[str] = ()) -> TrainConfig:
    """The configuration that ``FILE.toml[:word,word…]`` and ``key=value`` settings name.

    A recipe may say ``extends = "other.toml"``: that file's tables, with its own on top. Under
    ``[choices]`` stand groups of words, of which a run takes one each, the first where none is
    named. A table ``[with."word"]``, or ``[with."word,word"]``, is laid on top where all its words
    are taken; settings come last. ``model.preset`` stands for the values of a preset.

    Raises:
        ReadError: no such file, or it is no TOML.
        InputError: unknown words or keys, or values that don't fit; all at once.
    """
    path, _, named = spec.rpartition(":") if not Path(spec).exists() else (spec, "", "")
    if not path.endswith(".toml"):
        path, named = spec, ""
    content = _read(Path(path), seen=())
    choices, layers = content.pop(_CHOICES, {}), content.pop(_WITH, {})
    asked = [word for word in named.split(",") if word]
    taken = _take(choices, asked, spec)
    for words, layer in layers.items():
        if set(words.split(",")) <= set(taken):
            content = _merged(content, layer)
    for setting in settings:
        content = _merged(content, _setting(setting))
    content.setdefault("name", "-".join([Path(path).stem, *taken]))
    return from_table(TrainConfig, _with_preset(content, spec), name=spec)


def family(path: str) -> dict[str, list[str]]:
    """The groups of words that a recipe offers, by the name of the group."""
    return {group: list(words) for group, words in _read(Path(path), seen=())[_CHOICES].items()}


def _read(path: Path, *, seen: tuple[Path, ...]) -> dict[str, Any]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(
            f"expected a recipe FILE.toml[:words] at {path}: {error.strerror}; check the path"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReadError(f"expected TOML in {path}: {one_line(error)}; correct the file") from error
    below = content.pop(_EXTENDS, None)
    if below is None:
        return content
    if path.resolve() in seen:
        raise InputError(f"expected recipes that end somewhere; {path} extends itself")
    return _merged(_read(path.parent / below, seen=(*seen, path.resolve())), content)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Tables joined key by key; any other value of `above` replaces that of `below`."""
    joined = dict(below)
    for key, value in above.items():
        old = joined.get(key)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        joined[key] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return joined


def _take(choices: Mapping[str, list[str]], asked: list[str], spec: str) -> list[str]:
    known = {word: group for group, words in choices.items() for word in words}
    problems = [f"unknown word {word}" for word in asked if word not in known]
    taken = []
    for group, words in choices.items():
        here = [word for word in dict.fromkeys(asked) if known.get(word) == group]
        if len(here) > 1:
            problems.append(f"{group}: expected one of them, got {' and '.join(here)}")
        taken.append(here[0] if here else words[0])
    if problems:
        offer = "; ".join(f"{group}: {', '.join(words)}" for group, words in choices.items())
        raise InputError(f"{spec}: {' | '.join(problems)}; the recipe offers {offer or 'no words'}")
    return taken


def _setting(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not all(part.isidentifier() for part in key.split(".")):
        raise InputError(f"expected settings as key=value, such as data.batch=8; got {text!r}")
    try:
        table = tomllib.loads(f"{key} = {value}")
    except tomllib.TOMLDecodeError:
        # A word without quotes.
        table = tomllib.loads(f"{key} = '''{value}'''") if "'" not in value else {}
    if not table:
        raise InputError(f"expected a TOML value after {key}=, got {value!r}; quote it")
    return table


def _with_preset(content: dict[str, Any], spec: str) -> dict[str, Any]:
    model = content.get("model")
    if not isinstance(model, Mapping) or "preset" not in model:
        return content
    chosen = {key: value for key, value in model.items() if key != "preset"}
    if model["preset"] not in PRESETS:
        raise InputError(
            f"{spec}: model.preset: expected one of {', '.join(PRESETS)}; got {model['preset']!r}"
        )
    return {**content, "model": {**to_table(PRESETS[model["preset"]]), **chosen}}
