"""The harness uses only those attributes of a dataset that its protocol names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fake_method import write_method
from small_dataset import write_dataset

from dofbench.core.budget import Budget
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.protocol import protocol_for
from dofbench.evaluation.scoring.evaluate import Evaluator
from dofbench.evaluation.scoring.ground_truth import photograph_columns
from dofbench.methods.cards import find_method
from dofbench.methods.stages.facts import facts_of
from dofbench.running.data_plan import plan_for_data
from dofbench.running.observer import OneStep

EVERY = tuple(f"v{index}" for index in range(6))


class Narrow:
    """A wrapper that gives access only to the attributes that a protocol names."""

    def __init__(self, whole: Any, protocol: type):
        self._whole = whole
        self._named = {name for name in vars(protocol) if not name.startswith("_")}

    def __getattr__(self, name: str) -> Any:
        if name not in self._named:
            raise AttributeError(f"the harness asks for {name}, which its protocol doesn't name")
        return getattr(self._whole, name)


class NarrowDataset(Narrow):
    """A wrapped dataset whose views are wrapped too."""

    def __init__(self, whole: Dataset):
        super().__init__(whole, BenchmarkDataset)
        self.views = tuple(Narrow(view, BenchmarkView) for view in whole.views)

    def training_views(self) -> tuple[Narrow, ...]:
        return tuple(view for view in self.views if view.split == "train")

    def test_views(self) -> tuple[Narrow, ...]:
        return tuple(view for view in self.views if view.split == "test")


def test_what_is_not_named_is_not_there(tmp_path: Path) -> None:
    narrow = NarrowDataset(Dataset.load(write_dataset(tmp_path / "data")))
    assert narrow.name == "waves" and narrow.views[0].name == "v0"
    with pytest.raises(AttributeError, match="asks for manifest"):
        _ = narrow.manifest


@pytest.mark.parametrize(
    "unknown",
    [{}, {"unknown": EVERY, "blurred": EVERY, "flat": EVERY, "exact": False}],
    ids=["known lenses", "photographs"],
)
def test_planning_and_scoring_ask_for_what_the_protocol_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unknown: dict
) -> None:
    monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods")))
    dataset = NarrowDataset(Dataset.load(write_dataset(tmp_path / "data", **unknown)))
    entry, protocol = find_method("fake"), protocol_for("shallow", photographs=photograph_columns(dataset))
    training_set = dataset.training_set("shallow")
    plan = plan_for_data(
        entry,
        {},
        {},
        dataset,
        facts_of(training_set, one_lens=None),
        protocol,
        force_all=True,
    )
    method = entry.create(plan.options, 0, "cpu")
    method.fit(training_set, Budget(steps=1), OneStep())
    evaluator = Evaluator(method, dataset, protocol, columns=plan.columns, left_out=plan.left_out)
    assert bool(evaluator.do_nothing()) is not bool(unknown)
    assert evaluator.quick() and evaluator.final(tmp_path / "result").scores
