"""Held-out pixels of the training set: no method receives them, and scores are of these alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_method import fake_run
from small_dataset import HEIGHT, WIDTH, write_dataset

from dofbench.core.contracts import TrainingSet
from dofbench.core.held_out import TILE
from dofbench.core.similarity import psnr
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.collecting import collect
from dofbench.evaluation.results.result import Spec, read_result
from dofbench.evaluation.scoring.evaluate import Evaluator
from dofbench.evaluation.scoring.held_out_scores import NO_PREDICTION, held_out_scores
from dofbench.methods.cards import MethodEntry
from dofbench.methods.stages.facts import facts_of

SHARE = 0.2
COLUMNS = ("held_out_psnr", "held_out_ssim")


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return Dataset.load(write_dataset(tmp_path / "data"))


def scribble(dataset: Dataset, monkeypatch: pytest.MonkeyPatch, pixels: dict[str, np.ndarray]) -> None:
    """Change the images at these pixels, by view."""
    read = Dataset.image

    def image(self: Dataset, view: Any) -> np.ndarray:
        found = read(self, view)
        at = pixels[view.name]
        found[at] = np.random.default_rng(1).random((int(at.sum()), 3))
        return found

    monkeypatch.setattr(Dataset, "image", image)


def equal(one: TrainingSet, other: TrainingSet) -> bool:
    """Whether a method can't tell one from the other."""
    pairs = zip(one.views, other.views, strict=True)
    same = all(np.array_equal(a.image, b.image) and np.array_equal(a.mask, b.mask) for a, b in pairs)
    assert one.points is not None and other.points is not None
    return (
        same and np.array_equal(one.points.xyz, other.points.xyz) and np.array_equal(one.points.rgb, other.points.rgb)
    )


def test_tiles_are_held_out_of_every_view(dataset: Dataset) -> None:
    held = dataset.held_out(SHARE)
    assert held.keys() == {view.name for view in dataset.training_views()}
    tiles = -(-HEIGHT // TILE) * -(-WIDTH // TILE)
    for pixels in held.values():
        assert pixels.shape == (HEIGHT, WIDTH) and pixels[::TILE, ::TILE].sum() == round(SHARE * tiles)
    assert len({pixels.tobytes() for pixels in held.values()}) > 1
    for view in dataset.training_set(held_out=SHARE).views:
        assert np.array_equal(view.mask, ~held[view.name])
    for share in (0.0, 1.0, -1.0):
        with pytest.raises(ValueError, match="between 0 and 1"):
            dataset.held_out(share)


def test_what_is_held_out_reaches_no_method(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    before, whole = dataset.training_set(held_out=SHARE), dataset.training_set()
    facts = facts_of(before, one_lens=None)
    scribble(dataset, monkeypatch, dataset.held_out(SHARE))
    after = dataset.training_set(held_out=SHARE)
    assert equal(before, after) and facts_of(after, one_lens=None) == facts
    assert not equal(whole, dataset.training_set())


def test_what_is_not_held_out_does(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    before = dataset.training_set(held_out=SHARE)
    scribble(dataset, monkeypatch, {name: ~pixels for name, pixels in dataset.held_out(SHARE).items()})
    assert not equal(before, dataset.training_set(held_out=SHARE))


def test_masked_pixels_are_not_held_out_and_a_view_keeps_some(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    free, first = dataset.held_out(SHARE), dataset.training_views()[0].name
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:, : WIDTH // 2] = False
    monkeypatch.setattr(Dataset, "mask", lambda self, view: free[first] if view.name == first else mask)
    held = dataset.held_out(SHARE)
    assert not held[first].any()  # nothing else would be left of it
    assert all(np.array_equal(held[name], free[name] & mask) for name in held if name != first)
    assert len(dataset.training_set(held_out=SHARE).views) == len(held)


class Guessing:
    """Predicts grey where it is asked, and nothing elsewhere."""

    def predict_photograph(self, name: str, pixels: np.ndarray) -> np.ndarray:
        return np.where(pixels[..., None], np.float32(0.5), np.nan) * np.ones(3, np.float32)


def test_scores_are_of_held_out_pixels_alone(dataset: Dataset) -> None:
    scores, left_out = held_out_scores(Guessing(), dataset, "shallow", SHARE)
    by_view = []
    for view in dataset.training_views():
        at = dataset.held_out(SHARE)[view.name]
        image = dataset.image(view)[at][None]
        by_view.append(psnr(np.full_like(image, 0.5), image))
    assert scores["held_out_psnr"] == pytest.approx(np.mean(by_view)) and not left_out
    assert np.isfinite(scores["held_out_ssim"])
    assert held_out_scores(object(), dataset, "shallow", SHARE) == ({}, dict.fromkeys(COLUMNS, NO_PREDICTION))


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    return fake_run(tmp_path, monkeypatch)


def test_a_run_trains_without_them_and_is_scored_on_them(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[TrainingSet] = []
    create = MethodEntry.create

    def watched(self: MethodEntry, *args: Any) -> Any:
        method = create(self, *args)
        fit = method.fit

        def fit_and_tell(shown: TrainingSet, *rest: Any) -> Any:
            received.append(shown)
            return fit(shown, *rest)

        method.fit = fit_and_tell
        return method

    monkeypatch.setattr(MethodEntry, "create", watched)
    result = read_result(call(held_out=SHARE).folder)
    assert equal(received[-1], Dataset.load(tmp_path / "data").training_set(held_out=SHARE))
    assert set(COLUMNS) <= result.scores.keys()
    assert result.spec.held_out == SHARE and "--held-out 0.2" in result.command
    assert not set(COLUMNS) & read_result(call().folder).scores.keys()


def test_runs_with_and_without_them_are_rows_of_their_own(call, tmp_path: Path) -> None:
    folders = {call(**changes).folder for changes in ({}, {"held_out": 0.1}, {"held_out": SHARE})}
    found = collect(tmp_path / "results").entries
    assert len(folders) == len({entry.variant for entry in found}) == 3
    assert {entry.preset for entry in found} == {"quick", "quick held_out=0.1", "quick held_out=0.2"}


def test_a_run_without_them_has_the_key_that_it_had(call) -> None:
    spec = read_result(call().folder).spec
    data = spec.model_dump(exclude={"held_out"})
    assert spec.held_out == 0 and Spec(**data).key == spec.key != Spec(**data, held_out=SHARE).key


def test_scores_survive_an_interruption_of_scoring(call, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*args: Any, **changes: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Evaluator, "final", interrupted)
        call(held_out=SHARE)
    again = read_result(call(held_out=SHARE).folder)
    anew = read_result(call(held_out=SHARE, rerun=True).folder)
    assert [again.scores[column] for column in COLUMNS] == [anew.scores[column] for column in COLUMNS]
