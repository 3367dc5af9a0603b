"""Tuning a depth network: the order of the photographs, Adam's rate, and the depth that a view is tuned by."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.training.common.depth import DepthMap
from dofbench.training.common.priors import network as tuning


class Number(torch.nn.Module):
    """One parameter."""

    def __init__(self) -> None:
        super().__init__()
        self.number = torch.nn.Parameter(torch.tensor(1.0, dtype=torch.float64))


def _photographs(count: int) -> tuple[TrainingSet, list[DepthMap]]:
    image = np.full((32, 32, 3), 0.5, np.float32)
    views = tuple(TrainingView(f"v{index}", frontal(32, 32, 30.0), image) for index in range(count))
    known = [DepthMap(np.full((32, 32), 2.0, np.float32), np.ones((32, 32), np.float32)) for _ in range(count)]
    return TrainingSet(views, None), known


def _tuned(monkeypatch: pytest.MonkeyPatch, count: int, steps: int) -> tuple[list[list[str]], list[float]]:
    """The photographs of each step, and the parameter before each and at the end, where the gradient is always 1."""
    network, batches, values = Number(), [], []

    def run(given: Number, images: torch.Tensor, names: str) -> torch.Tensor:
        batches.append(names.split(", "))
        values.append(float(given.number.detach()))
        assert len(images) == len(batches[-1])
        return images[:, :1]

    monkeypatch.setattr(tuning, "run", run)
    monkeypatch.setattr(tuning, "scale_invariant_loss", lambda *_: network.number)
    tuning.tune(network, *_photographs(count), steps=steps, loss="squared", seed=3)
    return batches, [*values, float(network.number.detach())]


def test_every_photograph_is_taken_once_a_round_five_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    batches, _ = _tuned(monkeypatch, 7, 14)
    assert [len(batch) for batch in batches] == [5] * 14
    drawn = [name for batch in batches for name in batch]
    rounds = [drawn[start : start + 7] for start in range(0, 70, 7)]
    assert all(sorted(names) == [f"v{index}" for index in range(7)] for names in rounds)
    assert len({tuple(names) for names in rounds}) > 5  # in an order of its own each


def test_few_photographs_are_all_taken_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    batches, _ = _tuned(monkeypatch, 3, 4)
    assert all(len(batch) >= 3 for batch in batches)


def test_the_rate_falls_to_a_tenth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a gradient that stays the same, Adam moves a parameter by exactly its rate: 4e-4, times 0.1 to the power
    of the share of the steps."""
    _, values = _tuned(monkeypatch, 2, 9)
    expected = [4e-4 * 0.1 ** (step / 10) for step in range(9)]
    assert -np.diff(values) == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_points_come_before_other_depth_in_their_pixels() -> None:
    """At the network's size, half as large here; log depth, and a weight of 1 for a point."""
    camera = frontal(32, 32, 16.0)
    depth, weight = np.zeros((32, 32), np.float32), np.zeros((32, 32), np.float32)
    depth[4:6, 8:10], weight[4:6, 8:10] = 3.0, 0.25
    depth[20, 21], weight[20, 21] = 5.0, 0.5
    # Of the pixel (row 4, column 8): its centre is at (8.5 - 16, 4.5 - 16) / 16 of the depth.
    points = cloud([((8.5 - 16) / 16 * 7, (4.5 - 16) / 16 * 7, 7.0)], views=[np.array([0])])
    view = TrainingView("v", camera, np.zeros((32, 32, 3), np.float32))
    log_depth, counted = tuning._target(TrainingSet((view,), points), 0, DepthMap(depth, weight), torch.Size((16, 16)))
    expected, share = np.zeros((1, 16, 16)), np.zeros((1, 16, 16))
    expected[0, 2, 4], share[0, 2, 4] = np.log(7), 1.0
    expected[0, 10, 10], share[0, 10, 10] = np.log(5), 0.5
    assert np.allclose(log_depth.numpy(), expected, rtol=FLOAT32_VALUE)
    assert np.allclose(counted.numpy(), share, rtol=FLOAT32_VALUE)
