"""The table of what a GPU's trainings reached beside a CPU's."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.gpu import scores
from dofbench.core.errors import InputError, Status


def entry(seed: int, psnr: float, method: str = "a", budget: str = "1000it") -> Any:
    spec = SimpleNamespace(
        method=method, preset="cpu", options={}, budget=budget, dataset_checksum="0", protocol="p", seed=seed
    )
    return SimpleNamespace(spec=spec, scores={"aif_psnr": psnr, "train_s": 3.0})


def test_a_row_holds_the_same_seed_s_and_the_range_of_all_seeds() -> None:
    cpu = [entry(0, 25.0), entry(1, 26.0), entry(2, 24.5), entry(0, 99.0, "b"), entry(3, 99.0, budget="2000it")]
    cpu.insert(0, entry(0, 30.0))  # the same seed, of older code, isn't another one
    assert scores.rows([entry(0, 25.25), entry(7, 1.0), entry(0, 1.0, "c")], cpu) == [
        {
            "method": "a", "score": "aif_psnr", "gpu": 25.25, "cpu": 25.0, "difference": 0.25,
            "cpu_least": 24.5, "cpu_most": 26.0, "cpu_seeds": 3,
        }
    ]  # fmt: skip


def test_a_folder_without_results_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no result.json"):
        scores.finished(tmp_path)


def test_the_latest_run_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    times = ["2026-11-26T17:00:00", "2026-11-26T06:00:00", "2026-11-26T16:00:00"]
    entries = [SimpleNamespace(status=Status.OK, result=SimpleNamespace(started=time)) for time in times]
    entries.append(SimpleNamespace(status=Status.DIVERGED, result=SimpleNamespace(started="")))
    monkeypatch.setattr(scores, "collect", lambda folder: SimpleNamespace(entries=entries))
    assert [one.result.started for one in scores.finished(Path())] == sorted(times)
