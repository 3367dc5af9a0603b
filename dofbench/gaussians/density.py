"""Density control: grow where the image asks for detail, prune what is transparent (3DGS)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.gaussians.model import PARAMETERS, Gaussians
from dofbench.gaussians.optimiser import GaussianOptimiser
from dofbench.learning.options import TrainerOptions

_SPLIT_SHRINK = 1.6  # 3DGS: two children, each 1 / 1.6 as large
_RESET_OPACITY = 0.01


class DensityControl:
    """Accumulates screen-space gradients and, when due, clones, splits, prunes and resets."""

    def __init__(
        self,
        gaussians: Gaussians,
        optimiser: GaussianOptimiser,
        options: TrainerOptions,
        extent: float,
        generator: torch.Generator,
    ):
        self._gaussians, self._optimiser, self._options = gaussians, optimiser, options
        self._extent, self._generator = extent, generator
        self._next_reset = options.reset_every
        self._clear()

    def _clear(self) -> None:
        self._gradient_sum = torch.zeros(len(self._gaussians))
        self._visits = torch.zeros(len(self._gaussians))

    def state(self) -> tuple[Tensor, Tensor, float]:
        """What was accumulated, to come back to."""
        return self._gradient_sum.clone(), self._visits.clone(), self._next_reset

    def restore(self, state: tuple[Tensor, Tensor, float]) -> None:
        """Go on from a `state`."""
        gradient_sum, visits, self._next_reset = state
        self._gradient_sum, self._visits = gradient_sum.clone(), visits.clone()

    def record(self, gradient_2d: Tensor, visible: Tensor, width: int, height: int) -> None:
        """Add one view's gradient by the projected means, (N, 2) per pixel, in 3DGS's NDC unit."""
        x, y = gradient_2d[:, 0] * (0.5 * width), gradient_2d[:, 1] * (0.5 * height)
        self._gradient_sum += torch.sqrt(x * x + y * y)
        self._visits += visible

    def due(self, step: int) -> bool:
        """Whether the schedule has growing and pruning at this step, if it is the time of training for it."""
        return step % self._options.densify_every == 0

    def after_step(
        self, step: int, progress: float, depth_of_means: Tensor | None = None, *, overdue: bool = False
    ) -> bool:
        """Do what is due; True when Gaussians were added or removed. overdue: growing and pruning was put off."""
        options = self._options
        if options.reset_every > 0 and progress >= self._next_reset and progress < options.densify_until:
            self._next_reset += options.reset_every
            if progress > options.densify_from:  # the released code resets only while it densifies
                self._reset_opacity()
        if not (overdue or self.due(step)) or not options.densify_from <= progress < options.densify_until:
            return False
        self._grow_and_prune(depth_of_means)
        self._clear()
        return True

    @torch.no_grad()
    def _grow_and_prune(self, depth_of_means: Tensor | None) -> None:
        gaussians, options = self._gaussians, self._options
        parameters = {name: value.detach() for name, value in gaussians.parameters.items()}
        gradient = self._gradient_sum / self._visits.clamp(min=1)
        grow = gradient >= options.grow_gradient
        room = options.max_gaussians - len(gaussians)
        if int(grow.sum()) > max(room, 0):
            # Not all fit: those with the largest gradient first.
            grow = torch.zeros_like(grow)
            if room > 0:
                grow[torch.topk(gradient, room).indices] = True
                grow &= gradient >= options.grow_gradient
        large = parameters["log_scales"].max(dim=1).values > math.log(options.dense_share * self._extent)
        clone, split = grow & ~large, grow & large

        threshold = torch.full_like(gradient, options.prune_opacity)
        if options.prune_depth_graded and depth_of_means is not None:
            near, far = depth_of_means.min(), depth_of_means.max()
            threshold /= 1 + 2 * (depth_of_means - near) / (far - near).clamp(min=1e-12)
        opacity = torch.sigmoid(parameters["opacity_logits"])
        transparent = opacity < threshold
        if options.clone_opacity == "share":
            # Two copies of 1 - sqrt(1 - o) in front of each other let through as much light as one of o.
            shared = 1 - torch.sqrt(1 - opacity[clone])
            parameters["opacity_logits"][clone] = torch.logit(shared, eps=1e-6)
        cloned = {name: value[clone & ~transparent] for name, value in parameters.items()}
        children = self._children({name: value[split & ~transparent] for name, value in parameters.items()})
        added = {name: torch.cat([cloned[name], children[name]]) for name in PARAMETERS}
        kept = torch.nonzero(~(transparent | split))[:, 0]
        self._optimiser.rebuild(kept, added)

    def _children(self, parents: dict[str, Tensor]) -> dict[str, Tensor]:
        """Two children a parent, drawn from the parent's own density."""
        children = {name: value.repeat(2, *[1] * (value.ndim - 1)) for name, value in parents.items()}
        scales = children["log_scales"].exp()
        offsets = torch.randn(scales.shape, generator=self._generator) * scales
        children["means"] = children["means"] + rotate(children["quaternions"], offsets)
        children["log_scales"] = children["log_scales"] - math.log(_SPLIT_SHRINK)
        return children

    @torch.no_grad()
    def _reset_opacity(self) -> None:
        logit = math.log(_RESET_OPACITY / (1 - _RESET_OPACITY))
        opacity = self._gaussians.parameters["opacity_logits"].detach()
        self._optimiser.replace("opacity_logits", opacity.clamp(max=logit))


def rotate(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors (N, 3) by quaternions (N, 4), w first, of any non-zero length."""
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    twice = 2 * torch.linalg.cross(axis, vectors)
    return vectors + w * twice + torch.linalg.cross(axis, twice)
