"""Bytes that a training keeps for a pixel of its views: counted over all arrays that can be reached from it."""

from __future__ import annotations

import types
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import training_set

from dofbench.core.budget import Budget
from dofbench.core.contracts import Method, TrainingSet
from dofbench.core.images import from_8bit, to_8bit
from dofbench.methods.cards import find_method


def array_bytes(root: Any) -> int:
    """Bytes of the arrays and tensors that can be reached from an object, each memory once."""
    found: dict[int, int] = {}
    seen, todo = set[int](), [root]
    while todo:
        one = todo.pop()
        if id(one) in seen or isinstance(one, type | types.ModuleType | str | bytes | int | float):
            continue
        seen.add(id(one))
        if isinstance(one, torch.Tensor):
            storage = one.untyped_storage()
            found[storage.data_ptr()] = max(found.get(storage.data_ptr(), 0), storage.nbytes())
        elif isinstance(one, np.ndarray):
            while isinstance(one.base, np.ndarray):
                one = one.base
            found[one.ctypes.data] = max(found.get(one.ctypes.data, 0), one.nbytes)
        elif isinstance(one, dict):
            todo += one.values()
        elif isinstance(one, list | tuple | set | frozenset):
            todo += one
        elif isinstance(one, types.FunctionType):
            todo += [cell.cell_contents for cell in one.__closure__ or ()]
        elif hasattr(one, "__dict__"):
            todo += vars(one).values()
    return sum(found.values())


class Counting(Recorder):
    """Counts the bytes of a method and its training set after given steps."""

    def __init__(self, method: Method, given: TrainingSet, steps: tuple[int, ...]):
        super().__init__()
        self._roots, self._steps, self.bytes = (method, given), steps, list[int]()

    def after_step(self, step: int, loss: float) -> bool:
        if step in self._steps:
            self.bytes.append(array_bytes(self._roots))
        return super().after_step(step, loss)


def given(times: int, masked: bool) -> TrainingSet:
    """The small scene at 8 bits, each view so many times."""
    scene, views = training_set(), []
    for number in range(times):
        for view in scene.views:
            mask = np.random.default_rng(number).random(view.image.shape[:2]) < 0.9 if masked else None
            views.append(replace(view, name=f"{view.name}-{number}", image=from_8bit(to_8bit(view.image)), mask=mask))
    assert scene.points is not None
    few = np.arange(len(scene.points)) < 40  # samples of sparse depth are 12 bytes a point, in each view that sees it
    return TrainingSet(tuple(views), scene.points.kept(few))


# Most bytes a pixel at the first step and at the last. 3 are the image; its quarter in floats is there while training
# is coarse, with its depth; 4 1/8 are a depth everywhere; a mask is one byte, and held-out pixels one bit; 4 are the
# order in which a field draws its pixels, and 3 its copy of the images.
CASES = [
    ("3dgs", {}, False, 3.5, 3.5),
    ("3dgs", {"coarse_until": 0.5, "held_back": 0.2}, False, 7.0, 3.8),
    ("3dgs", {"coarse_until": 0.5}, True, 8.0, 4.8),
    ("dofgaussian", {"depth_prior": "network", "coarse_until": 0.5}, False, 11.8, 7.7),
    ("dofgaussian", {"depth_prior": "network", "coarse_until": 0.5}, True, 13.1, 9.0),
    ("nerf", {}, False, 10.4, 10.4),
    ("nerf", {}, True, 11.2, 11.2),
]


@pytest.mark.parametrize(("name", "overrides", "masked", "first", "last"), CASES)
def test_bytes_kept_for_a_pixel(name: str, overrides: dict[str, Any], masked: bool, first: float, last: float) -> None:
    found = []
    for times in (1, 3):
        entry = find_method(name)
        _, options, _ = entry.preset("smoke")
        more = {} if name == "nerf" else {"max_gaussians": 250}
        method = entry.create({**options, **overrides, **more, "steps": 8}, 0, "cpu")
        scene = given(times, masked)
        counting = Counting(method, scene, (1, 8))
        method.fit(scene, Budget(steps=8), counting)
        found.append(np.array(counting.bytes))
    pixels = 2 * 3 * training_set().views[0].image[..., 0].size
    bytes_a_pixel = (found[1] - found[0]) / pixels
    assert (bytes_a_pixel >= 3).all(), "an image takes three bytes a pixel at least: some array isn't counted"
    assert bytes_a_pixel[0] <= first and bytes_a_pixel[1] <= last, bytes_a_pixel
