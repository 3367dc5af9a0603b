"""Scores of a whole run don't depend on what is under a dataset's masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_method import write_method
from relisted import relist
from small_dataset import write_dataset

from dofbench.core.budget import Budget
from dofbench.core.images import read_exr, read_image, write_exr, write_png
from dofbench.core.masks import write_mask
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.protocol import protocol_for
from dofbench.evaluation.scoring.evaluate import Evaluation, Evaluator
from dofbench.evaluation.scoring.ground_truth import photograph_columns
from dofbench.methods.cards import find_method
from dofbench.methods.stages.facts import facts_of
from dofbench.running.compiling import miniature
from dofbench.running.data_plan import plan_for_data
from dofbench.running.observer import OneStep

EVERY = tuple(f"v{index}" for index in range(6))
KINDS = {"known lenses": {}, "photographs": {"unknown": EVERY, "blurred": EVERY, "flat": EVERY, "exact": False}}


def mask_of(index: int) -> np.ndarray:
    """Of a view of the small dataset."""
    mask = np.ones((48, 64), bool)
    mask[5:25, 6 * index : 6 * index + 20] = False
    return mask


def masked(folder: Path, seed: int, kind: str) -> Dataset:
    """The small dataset with masks, and with noise under them."""
    write_dataset(folder, **KINDS[kind])
    random = np.random.default_rng(seed)
    for index, name in enumerate(EVERY):
        mask = mask_of(index)
        write_mask(folder / "masks" / f"{name}.png", mask)
        for place in ("images", "all_in_focus"):
            path = folder / place / f"{name}.png"
            if path.is_file():
                noise = random.uniform(size=(48, 64, 3)).astype(np.float32)
                write_png(path, np.where(mask[..., None], read_image(path), noise))
        if (path := folder / "depth" / f"{name}.exr").is_file():
            write_exr(path, np.where(mask, read_exr(path), random.uniform(1, 9, mask.shape)).astype(np.float32))
    relist(folder)
    return Dataset.load(folder)


def scored(dataset: Dataset, folder: Path, *, force_all: bool = True) -> tuple[Evaluation, dict]:
    """(scores, plan as the result keeps it)."""
    entry, protocol = find_method("fake"), protocol_for("shallow", photographs=photograph_columns(dataset))
    given = dataset.training_set("shallow")
    plan = plan_for_data(entry, {}, {}, dataset, facts_of(given, one_lens=None), protocol, force_all=force_all)
    method = entry.create(plan.options, 0, "cpu")
    method.fit(given, Budget(steps=1), OneStep())
    evaluator = Evaluator(method, dataset, protocol, columns=plan.columns, left_out=plan.left_out)
    return evaluator.final(folder), plan.as_data()


@pytest.mark.parametrize("kind", KINDS)
def test_no_score_depends_on_masked_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods")))
    (one, plan), (two, _) = (
        scored(masked(tmp_path / str(seed), seed, kind), tmp_path / f"result{seed}") for seed in (1, 2)
    )
    assert one.scores == two.scores and one.predictions == two.predictions
    splits = {view.name: view.split for view in Dataset.load(tmp_path / "1").views}
    shares = {
        split: float(np.mean([~mask_of(index) for index, name in enumerate(EVERY) if splits[name] == split]))
        for split in ("train", "test")
    }
    assert plan["masked"] == shares
    whole, unmasked = scored(Dataset.load(write_dataset(tmp_path / "whole", **KINDS[kind])), tmp_path / "all")
    assert whole.scores != one.scores and "masked" not in unmasked


def test_the_warm_up_takes_masked_views(tmp_path: Path) -> None:
    small = miniature(masked(tmp_path / "data", 1, "photographs").training_set())
    assert all(view.image.shape[:2] == (view.camera.height, view.camera.width) for view in small.views)
