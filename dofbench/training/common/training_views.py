"""Training photographs as the training loop needs them: at each training size, with their known depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView
from dofbench.core.images import resize
from dofbench.core.masks import shrunk_mask
from dofbench.training.common.held_back import held_back_mask
from dofbench.training.common.priors import Prior
from dofbench.training.common.supervision import DepthSamples


@dataclass(frozen=True, eq=False)
class Photograph:
    """One training view at one size. image: (H, W, 3), encoded. known: its known depth, or None. held_back: (H, W)
    bool, the pixels that no colour loss uses, masked ones among them, or None. used: share of the pixels that aren't
    masked."""

    index: int
    name: str
    camera: Camera
    image: Tensor
    known: DepthSamples | None
    held_back: Tensor | None
    used: float = 1.0


def all_photographs(
    views: Sequence[TrainingView], sizes: Sequence[int], prior: Prior | None, held_back: float, seed: int, device: str
) -> dict[int, list[Photograph]]:
    """Factor -> all training views shrunk by that factor, for each of the factors in `sizes`.

    prior: the depth that supervises, or None. held_back: the share of every photograph's tiles that no colour loss
    uses. device: where the tensors lie.
    """
    return {
        factor: [_photograph(view, index, factor, prior, held_back, seed, device) for index, view in enumerate(views)]
        for factor in sizes
    }


def _photograph(
    view: TrainingView, index: int, factor: int, prior: Prior | None, held_back: float, seed: int, device: str
) -> Photograph:
    width, height = view.camera.width // factor, view.camera.height // factor
    camera = view.camera if factor == 1 else view.camera.resized(width, height)
    image = torch.from_numpy(np.ascontiguousarray(resize(view.image, width, height))).to(device)
    known = None if prior is None else prior.samples(index, camera)
    held = held_back_mask(view.camera.height, view.camera.width, (height, width), held_back, seed, index)
    used = 1.0
    if view.mask is not None:
        valid = torch.from_numpy(shrunk_mask(view.mask, width, height))
        known = None if known is None else known.within(valid)
        held = ~valid if held is None else held | ~valid
        used = float(valid.double().mean())
    on_device = None if known is None else known.on(device)
    return Photograph(index, view.name, camera, image, on_device, None if held is None else held.to(device), used)
