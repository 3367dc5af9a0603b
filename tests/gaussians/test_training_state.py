"""A snapshot of a training brings everything back, the random numbers too."""

from __future__ import annotations

import numpy as np
import torch
from small_scene import options, training_set

from dofbench.training.gaussians.training_state import TrainingState


def test_a_snapshot_brings_back_what_training_changes() -> None:
    state = TrainingState(training_set(), options(colour_per_view="gain"), 0)
    assert state.lenses is not None and state.loss is None
    state.loss = torch.tensor(0.5)
    kept = state.snapshot()

    def drawn() -> tuple[float, float, list[int]]:
        order = [state.order.next(0.5, state.random) for _ in range(4)]
        return float(torch.rand(1, generator=state.generator)), float(state.random.uniform()), order

    first = drawn()
    lens, begun = state.lenses.aperture_and_focus(1), state.gaussians.parameters["means"].detach().clone()
    filtered = None if state.gaussians.filter_3d is None else state.gaussians.filter_3d.clone()
    assert drawn() != first
    state.lenses.spoil(0.25)
    state.loss = torch.tensor(0.1)
    state.revise({"lens": False, "adaptation": "off"})
    with torch.no_grad():
        state.gaussians.parameters["means"] += 1
    state.gaussians.filter_3d = None
    for _ in range(2):  # a snapshot stays usable
        state.restore(kept)
        assert state.options.lens.lens and state.lenses is not None and state.loss == 0.5
        assert state.lenses.aperture_and_focus(1) == lens
        assert torch.equal(state.gaussians.parameters["means"], begun)
        assert filtered is not None and torch.equal(state.gaussians.filter_3d, filtered)
        again = drawn()
        assert again[:2] == first[:2] and np.array_equal(again[2], first[2])
        state.gaussians.filter_3d.zero_()
