"""All that a training changes lies on the device that it was asked for, tried on torch's `meta`: shapes alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from small_scene import options, training_set
from torch import Tensor

from dofbench.training.common.lenses import LearnedLenses, lens_ties
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.training_state import TrainingState


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch) -> TrainingState:
    """On `meta`, without the 3D filter, which asks for numbers that nothing on `meta` has."""
    monkeypatch.setattr(Gaussians, "update_filter_3d", lambda self, cameras: None)
    return TrainingState(training_set(), options(colour_per_view="affine"), 0, "meta")


def tensors(thing: object, seen: set[int]) -> Iterator[Tensor]:
    """Every tensor that an object holds, at any depth."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, Tensor):
        yield thing
    elif isinstance(thing, dict):
        for value in thing.values():
            yield from tensors(value, seen)
    elif isinstance(thing, list | tuple):
        for value in thing:
            yield from tensors(value, seen)
    elif type(thing).__module__.startswith(("dofbench.", "torch.optim")):
        yield from tensors(getattr(thing, "__dict__", {}), seen)


def devices(thing: object) -> set[str]:
    return {tensor.device.type for tensor in tensors(thing, set())}


def test_every_tensor_of_a_state_lies_there(state: TrainingState) -> None:
    # Parameters, sums, and of colours and both parts of lenses three each.
    assert len(list(tensors(state, set()))) == 6 + 2 + 3 * 3
    assert devices(state) == {"meta"}


def test_so_do_shared_lenses_children_and_a_new_start(state: TrainingState, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LearnedLenses, "aperture_and_focus", lambda self, view: (0.5, 0.5))
    assert devices(state.lenses.shared(lens_ties(training_set().views, "scene"))) == {"meta"}
    parents = {name: value.detach()[:3] for name, value in state.gaussians.parameters.items()}
    children = state.density._children(parents)
    assert devices(children) == {"meta"} and children["means"].shape == (6, 3)
    state.start_from(training_set().points)
    assert devices(state) == {"meta"}


def test_the_same_children_are_drawn_wherever_they_lie(state: TrainingState) -> None:
    """The generator is one of the host: a seed's numbers don't depend on the device."""
    host = TrainingState(training_set(), options(), 0)
    before = host.generator.get_state()
    for one in (host, state):
        one.density._children({name: value.detach()[:3] for name, value in one.gaussians.parameters.items()})
    assert not torch.equal(host.generator.get_state(), before)
    assert torch.equal(host.generator.get_state(), state.generator.get_state())
