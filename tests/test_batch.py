"""register_many: the loop's results, errors in their places, and a clean Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fullturn import Registration, register_many
from fullturn.batch import RegistrationInterrupted
from fullturn.errors import FullturnError, InputError, ReadError
from fullturn.io import save_cloud
from fullturn.workers import THREAD_VARIABLES, Crew

CLOUD = np.random.default_rng(0).normal(size=(80, 3)) * (1.0, 0.7, 0.4)


class Unsendable:
    """Becomes points only in the process that made it."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return CLOUD

    def __reduce__(self) -> Any:
        raise TypeError("not to be sent")


class Broken:
    """Fails where nobody expects it."""

    @property
    def points(self) -> np.ndarray:
        raise RuntimeError("no points today")


def held_signals(_: None) -> set[Any]:
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, set()))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failing_pair_is_its_error_and_stops_no_other(workers: int, tmp_path: Path) -> None:
    save_cloud(tmp_path / "a.ply", CLOUD)
    pairs: list[Any] = [
        (CLOUD, CLOUD),
        (CLOUD[:2], CLOUD),
        (tmp_path / "a.ply", CLOUD),
        (tmp_path / "missing.ply", CLOUD),
        "not a pair",
        (CLOUD,),
        (Unsendable(), CLOUD),
        (CLOUD, None),
        (Broken(), CLOUD),
        (CLOUD, CLOUD + 1),
    ]
    results = register_many(iter(pairs), method="icp-point", workers=workers)
    kinds = [type(result) for result in results]
    good, bad = Registration, InputError
    assert kinds == [good, bad, good, ReadError, bad, bad, good, bad, FullturnError, good]
    assert results[9].T_target_source[0, 3] == pytest.approx(1.0)  # type: ignore[union-attr]


def test_no_pairs_and_wrong_arguments() -> None:
    assert register_many([], method="icp-point") == []
    wrong: list[dict[str, Any]] = [
        {"workers": 0},
        {"workers": 1.5},
        {"workers": 2.0},
        {"workers": True},
        {"workers": "a"},
        {"method": "x"},
        {"seed": -1},
        {"max_rotation_deg": 45},  # which ICP doesn't take
        {"method": "consensus", "max_rotation_deg": 0},
    ]
    for options in wrong:
        with pytest.raises(InputError):
            register_many([(CLOUD, CLOUD)], **{"method": "icp-point", **options})
    for pairs in (None, 5, "ab"):
        with pytest.raises(InputError, match="pairs"):
            register_many(pairs, method="icp-point")  # type: ignore[arg-type]


LIMITED = """
import torch
from fullturn.methods.base import Estimate, Method, Traits

class Limited(Method):
    name, summary, reference = "limited", "turns as far as it may", "this test"
    traits = Traits(limits_rotation=True)
    def estimate(self, source, target, *, rng, max_rotation_rad=None):
        T = torch.eye(4, dtype=torch.float64)
        c, s = torch.tensor(max_rotation_rad).cos(), torch.tensor(max_rotation_rad).sin()
        T[:2, :2] = torch.tensor([[c, -s], [s, c]])
        return Estimate(T[None], torch.tensor([0.5]))
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_every_pair_has_the_largest_rotation(workers: int, tmp_path: Path) -> None:
    (tmp_path / "limited.py").write_text(LIMITED)
    method = f"{tmp_path / 'limited.py'}:Limited"
    pairs = [(CLOUD, CLOUD)] * 2
    for result in register_many(pairs, method=method, max_rotation_deg=30, workers=workers):
        assert isinstance(result, Registration)
        assert result.T_target_source[1, 0] == pytest.approx(0.5)


def test_a_fault_in_a_method_is_one_pairs_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from fullturn.methods.classical.icp import IcpPoint

    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("a\nfault")

    monkeypatch.setattr(IcpPoint, "estimate", broken)
    (result,) = register_many([(CLOUD, CLOUD)], method="icp-point")
    assert type(result) is FullturnError
    assert str(result).startswith("method icp-point, estimate(): ZeroDivisionError: a fault (")
    assert result.__cause__ is None  # its frames would keep the clouds in memory


def test_interrupted_in_this_process() -> None:
    class Interrupt:
        def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
            raise KeyboardInterrupt

    pairs = [(CLOUD, CLOUD), (Interrupt(), CLOUD), (CLOUD, CLOUD)]
    with pytest.raises(RegistrationInterrupted, match="1 of 3 pairs") as caught:
        register_many(pairs, method="icp-point", workers=1, progress=True)
    assert [type(r) for r in caught.value.results] == [Registration, type(None), type(None)]


SCRIPT = """
import json, multiprocessing
import numpy as np
import fullturn
from fullturn.batch import RegistrationInterrupted

cloud = np.random.default_rng(0).normal(size=(300, 3)) * (1.0, 0.7, 0.4)

class Mark:
    def __array__(self, dtype=None, copy=None):
        print("eight were given out", flush=True)
        return cloud

if __name__ == "__main__":
    pairs = [(cloud, cloud)] * 8 + [(Mark(), cloud)] + [(cloud, cloud)] * 2000
    try:
        fullturn.register_many(pairs, method="icp-plane", workers=2)
    except RegistrationInterrupted as stop:
        done = [r is not None for r in stop.results]
        alive = len(multiprocessing.active_children())
        print(json.dumps([sum(done), len(done), done[0], alive]))
        raise
"""


def start(path: Path, text: str) -> subprocess.Popen[str]:
    path.write_text(text)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


def test_a_real_interrupt_keeps_the_finished_pairs(tmp_path: Path) -> None:
    process = start(tmp_path / "script.py", SCRIPT)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "eight were given out"
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group
    out, err = process.communicate(timeout=60)
    done, total, first, alive = json.loads(out)
    assert 6 <= done < total == 2009
    assert first is True
    assert alive == 0
    assert process.returncode != 0
    assert "RegistrationInterrupted" in err


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    text = SCRIPT.replace('if __name__ == "__main__":', "if True:")
    process = start(tmp_path / "script.py", text)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "worker processes cannot start: call this from under" in err


KILLER = """
import os, signal, sys
import numpy as np
import fullturn
from fullturn.methods.classical.icp import IcpPoint

cloud = np.random.default_rng(0).normal(size=(100, 3)) * (1.0, 0.7, 0.4)
honest = IcpPoint.estimate

def estimate(self, source, target, *, rng):
    if len(source.points) == 99:
        os.kill(os.getpid(), signal.SIGKILL)
    return honest(self, source, target, rng=rng)

IcpPoint.estimate = estimate

if __name__ == "__main__":
    pairs = [(cloud, cloud), (cloud[:99], cloud), (cloud, cloud), (cloud, cloud)]
    for result in fullturn.register_many(pairs, method="icp-point", workers=2):
        print(type(result).__name__, getattr(result, "args", ""))
"""


def test_a_worker_that_dies_costs_one_pair(tmp_path: Path) -> None:
    process = start(tmp_path / "script.py", KILLER)
    out, err = process.communicate(timeout=60)
    lines = out.splitlines()
    assert [line.split()[0] for line in lines] == [
        "Registration",
        "FullturnError",
        "Registration",
        "Registration",
    ], err
    assert "exit code -9" in lines[1]


def refuse(task: int) -> int:
    if task == 1:
        raise ValueError("not this one")
    return task


def test_a_task_that_raises_is_one_error() -> None:
    results: dict[int, Any] = {}
    with Crew(refuse, workers=1) as crew:
        crew.run(range(3), results.__setitem__)
    assert (results[0], results[2]) == (0, 2)
    assert str(results[1]) == "unexpected ValueError: not this one"


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows")
def test_workers_never_hear_an_interrupt() -> None:
    found: list[Any] = []
    with Crew(held_signals, workers=1) as crew:
        crew.run([None], lambda number, held: found.append(held))
    assert signal.SIGINT in found[0]
    assert signal.SIGINT not in held_signals(None)


def test_workers_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    found: dict[int, str | None] = {}
    with Crew(os.getenv, workers=1) as crew:
        crew.run(THREAD_VARIABLES, found.__setitem__)
    assert found == {0: "1", 1: "1", 2: "1"}
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
