"""What a camera makes of the light that its lens let through: vignetting, then the photograph's own colour."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dofbench.cameras import Camera
from dofbench.contracts import TrainingView
from dofbench.gaussians.colours import LearnedColours
from dofbench.gaussians.options import TrainerOptions
from dofbench.gaussians.vignetting import LearnedVignetting


class LearnedResponse:
    """The learned parts that the options ask for; without any, images come back as they are."""

    def __init__(self, views: Sequence[TrainingView], options: TrainerOptions):
        self.colours = LearnedColours(len(views), options) if options.colour_per_view != "off" else None
        self.vignetting = LearnedVignetting([view.exif for view in views], options) if options.vignetting else None
        self._parts = [part for part in (self.vignetting, self.colours) if part is not None]

    def forward(self, view: int, image: Tensor, camera: Camera) -> Tensor:
        """The encoded image (H, W, 3) as the camera recorded it; differentiable."""
        if self.vignetting is not None:
            image = self.vignetting.forward(view, image, camera)
        return image if self.colours is None else self.colours.forward(view, image)

    @torch.no_grad()
    def apply(self, view: int, image: Tensor, camera: Camera) -> Tensor:
        """As `forward`, without gradient."""
        if self.vignetting is not None:
            image = self.vignetting.apply(view, image, camera)
        return image if self.colours is None else self.colours.apply(view, image)

    def gradient(self) -> Tensor | None:
        """Gradient by all raw parameters of the view of the last `forward`; None where nothing is learned."""
        found = [part.gradient() for part in self._parts if part.gradient() is not None]
        return torch.cat(found) if found else None

    def step(self, view: int, progress: float) -> None:
        """One Adam step on the parts of view number `view`."""
        for part in self._parts:
            part.step(view, progress)
