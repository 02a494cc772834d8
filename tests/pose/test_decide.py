"""One look where the verdict is sure, a second, wider one where it isn't."""

from __future__ import annotations

import pytest
import torch
from pose_shapes import pose_error, random_motions, teapot

from fullturn.geometry import rigid
from fullturn.geometry.cloud import Cloud
from fullturn.nn.surface import load_surface_net
from fullturn.pose import decide
from fullturn.pose.decide import find_and_judge
from fullturn.pose.search import Search, SearchConfig, find_finalists
from fullturn.pose.verdict import finalist_probabilities

T_TRUE = random_motions(1, seed=4)[0]
SMALL = SearchConfig(
    coarse_points=300, modes=12, matched_modes=12, finalists=4, matched_finalists=4
)


def easy() -> tuple[Cloud, Cloud]:
    source, target = teapot(900, 1)[0], teapot(900, 2)[0]
    return Cloud(source), Cloud(rigid.apply(T_TRUE, target))


def unrelated() -> tuple[Cloud, Cloud]:
    """A teapot and a cloud of dust."""
    dust = torch.randn(900, 3, generator=torch.Generator().manual_seed(3)).double()
    return Cloud(teapot(900, 1)[0]), Cloud(0.4 * dust)


def test_a_sure_verdict_ends_it_after_one_look() -> None:
    found, judged = find_and_judge(*easy(), config=SMALL)
    once = find_finalists(*easy(), config=SMALL)
    assert torch.equal(found.T_target_source, once.T_target_source)
    assert judged.doubt < 0.15
    angle, offset = pose_error(found.T_target_source[judged.index[0]][None], T_TRUE)
    assert float(angle) < 3.0
    assert float(offset) < 0.03


def test_doubt_has_more_poses_looked_at() -> None:
    once = find_finalists(*unrelated(), config=SMALL)
    found, judged = find_and_judge(*unrelated(), config=SMALL)
    assert judged.doubt > 0.15
    assert len(found.T_target_source) > len(once.T_target_source)
    assert len(found.features) == len(found.T_target_source)
    shares = finalist_probabilities(found.T_target_source, found.features)
    assert sum(judged.probability) + float(shares[-1]) == pytest.approx(1.0)


def test_a_second_look_is_what_a_wider_search_finds() -> None:
    found, _ = find_and_judge(*unrelated(), config=SMALL)
    wide = find_finalists(*unrelated(), config=SMALL.wider(modes=4, finalists=2))
    assert torch.equal(found.T_target_source, wide.T_target_source)
    assert torch.equal(found.features, wide.features)


def test_the_hypotheses_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Counted(Search):
        def __init__(self, *args: object, **options: object) -> None:
            made.append(1)
            super().__init__(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(decide, "Search", Counted)
    find_and_judge(*unrelated(), config=SMALL)
    assert len(made) == 1


def test_a_network_that_a_registration_loaded_can_still_be_trained() -> None:
    load_surface_net.cache_clear()
    find_and_judge(*easy(), config=SMALL)
    network = load_surface_net()
    assert network is not None
    sum(parameter.square().sum() for parameter in network.parameters()).backward()
    assert all(parameter.grad is not None for parameter in network.parameters())
