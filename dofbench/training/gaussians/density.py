"""Density control: add Gaussians where the image lacks detail, remove transparent ones (3DGS)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians.model import PARAMETERS, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser


class DensityPace:
    """Due every `every` steps, but not in a block of rest; what was due there, `overdue`, is due after the first step
    behind it."""

    def __init__(self, every: int):
        self._every = every
        self.resting = self.overdue = False

    @contextmanager
    def rest(self) -> Iterator[None]:
        """Postpone adding, removing and moving Gaussians, and resets, during the block."""
        self.resting = True
        try:
            yield
        finally:
            self.resting = False

    def due(self, step: int) -> bool:
        """Whether it is time after step number `step`; ask once after every step."""
        due = step % self._every == 0 or self.overdue
        self.overdue = self.resting and due
        return due and not self.resting


_SPLIT_SHRINK = 1.6  # 3DGS: two children, each 1 / 1.6 as large
_RESET_OPACITY = 0.01


@dataclass(frozen=True)
class DensityOptions:
    """When Gaussians are added and removed, and which."""

    max_gaussians: int = 1_000_000
    """Number of Gaussians above which none are added. Unit: none. Source: own."""
    densify_from: float = 1 / 60
    """When Gaussians begin to be added and removed. Unit: share of the training. Source: 3DGS; 0.1 in the released
    code."""
    densify_until: float = 0.5
    """When Gaussians cease to be added and removed. Unit: share of the training. Source: 3DGS; 2/3 in the released
    code."""
    densify_every: int = 100
    """Interval at which Gaussians are added and removed. Unit: steps. Source: 3DGS."""
    grow_gradient: float = 2e-4
    """Mean gradient of the loss with respect to a Gaussian's position in the image above which it is cloned or split.
    Unit: loss per half image. Source: 3DGS; 3e-4 in the released code."""
    grow_absolute: bool = False
    """Whether the gradient's absolute value is summed over the pixels. Unit: none. Source: AbsGS; off in the released
    code."""
    dense_share: float = 0.01
    """Size above which a Gaussian is split, and below which it is cloned. Unit: share of the scene's extent.
    Source: 3DGS."""
    clone_opacity: Literal["keep", "share"] = "keep"
    """Opacity of a clone: keep, that of the original, so that the two together are more opaque than the original was;
    share, divided between the two so that the rendering hardly changes. Unit: none. Source: keep: 3DGS; share: Rota
    Bulo et al., Revising Densification in Gaussian Splatting."""
    clone_place: Literal["same", "drawn"] = "same"
    """Where a clone is put: same, at the original's mean; drawn, at a place drawn from the original's distribution.
    Unit: none. Source: same: 3DGS; drawn: released code."""
    prune_opacity: float = 0.005
    """Opacity below which a Gaussian is removed. Unit: none. Source: 3DGS; 0.05 in the released code."""
    prune_depth_graded: bool = False
    """Whether prune_opacity is divided by 1 for the nearest Gaussian to 3 for the farthest. Unit: none. Source:
    released code."""
    prune_near: float = 0.0
    """Distance within which a Gaussian that one training view alone sees is removed, at any time: no other view tells
    how far it is. 0 for never. Unit: distance of the nearest sparse points. Source: own."""
    reset_every: float = 0.1
    """How often all opacities are reset; 0 for never. Unit: share of the training. Source: 3DGS."""
    reset_filtered: bool = False
    """Whether the opacity that is reset is the one after the 3D filter, which lowers it. Unit: none. Source: off: 3DGS;
    on: Mip-Splatting's code, released code."""

    @property
    def largest_kept(self) -> float:
        """Largest scale of a Gaussian after the first reset of opacities, share of the scene's extent."""
        return math.inf


class DensityControl:
    """Accumulates screen-space gradients and, when due, clones, splits, prunes and resets. pace: when it is due.
    cameras: of the training views, at any size. nearest: distance of the nearest sparse points, scene units."""

    cameras: Sequence[Camera] = ()
    nearest: float = 0.0

    def __init__(
        self,
        gaussians: Gaussians,
        optimiser: GaussianOptimiser,
        options: DensityOptions,
        extent: float,
        generator: torch.Generator,
    ):
        self._gaussians, self._optimiser, self._options = gaussians, optimiser, options
        self._extent, self._generator = extent, generator
        self._next_reset = options.reset_every
        self.pace = DensityPace(options.densify_every)
        self._clear()

    def _clear(self) -> None:
        means = self._gaussians.parameters["means"]
        self._gradient_sum = means.new_zeros(len(means))
        self._visits = means.new_zeros(len(means))

    def cost(self) -> Tensor | None:
        """Return a term of the loss, or None."""
        return None

    def state(self) -> tuple[Tensor, Tensor, float]:
        """A copy of the accumulated statistics, for `restore`."""
        return self._gradient_sum.clone(), self._visits.clone(), self._next_reset

    def restore(self, state: tuple[Tensor, Tensor, float]) -> None:
        """Set the accumulated statistics to a copy of an earlier `state`."""
        gradient_sum, visits, self._next_reset = state
        self._gradient_sum, self._visits = gradient_sum.clone(), visits.clone()

    def record(self, statistics: ViewStatistics, width: int, height: int) -> None:
        """Add the statistics of one view (width x height, px): gradients in NDC, as in 3DGS, and visits."""
        gradient_2d = statistics.abs_grad_2d if self._options.grow_absolute else statistics.grad_2d
        assert gradient_2d is not None and statistics.visible is not None
        x, y = gradient_2d[:, 0] * (0.5 * width), gradient_2d[:, 1] * (0.5 * height)
        self._gradient_sum += torch.hypot(x, y)
        self._visits += statistics.visible

    def after_step(self, step: int, progress: float) -> bool:
        """Grow, prune or reset if due after step number `step`; True when Gaussians were added or removed."""
        options = self._options
        due = self.pace.due(step)
        if self.pace.resting:
            return False
        if options.reset_every > 0 and progress >= self._next_reset and progress < options.densify_until:
            self._next_reset += options.reset_every
            if progress > options.densify_from:  # as in the released code: no reset before densification begins
                self._reset_opacity()
        if not due:
            return False
        grows = options.densify_from <= progress < options.densify_until
        if grows:
            pruned = options.largest_kept if 0 < options.reset_every < progress else math.inf
            self._grow_and_prune(pruned * self._extent)
            self._clear()
        return self._remove_floaters() or grows

    @torch.no_grad()
    def _grow_and_prune(self, largest: float) -> None:
        """largest: scale above which a Gaussian is removed, scene units."""
        gaussians, options = self._gaussians, self._options
        parameters = {name: value.detach() for name, value in gaussians.parameters.items()}
        gradient = self._gradient_sum / self._visits.clamp(min=1)
        grow = gradient >= options.grow_gradient
        room = options.max_gaussians - len(gaussians)
        if int(grow.sum()) > max(room, 0):
            # The candidates with the largest gradients fit below the limit.
            grow = torch.zeros_like(grow)
            if room > 0:
                grow[torch.topk(gradient, room).indices] = True
                grow &= gradient >= options.grow_gradient
        longest = parameters["log_scales"].max(dim=1).values
        large = longest > math.log(options.dense_share * self._extent)
        clone, split = grow & ~large, grow & large

        threshold = torch.full_like(gradient, options.prune_opacity)
        if options.prune_depth_graded:
            depth = parameters["means"][:, 2]  # the world's z, as the released code takes it
            near, far = depth.min(), depth.max()
            threshold /= 1 + 2 * (depth - near) / (far - near).clamp(min=1e-12)
        opacity = torch.sigmoid(parameters["opacity_logits"])
        transparent, huge = opacity < threshold, longest > math.log(largest)
        if options.clone_opacity == "share":
            # Two Gaussians of opacity 1 - sqrt(1 - o), one behind the other, let as much light through as one of
            # opacity o.
            shared = 1 - torch.sqrt(1 - opacity[clone])
            parameters["opacity_logits"][clone] = torch.logit(shared, eps=1e-6)
        cloned = {name: value[clone & ~transparent] for name, value in parameters.items()}
        if options.clone_place == "drawn":
            cloned["means"] = cloned["means"] + self._drawn(cloned)
        children = self._children({name: value[split & ~transparent] for name, value in parameters.items()})
        small = children["log_scales"].max(dim=1).values <= math.log(largest)
        children = {name: value[small] for name, value in children.items()}
        added = {name: torch.cat([cloned[name], children[name]]) for name in PARAMETERS}
        kept = torch.nonzero(~(transparent | huge | split))[:, 0]
        self._optimiser.rebuild(kept, added)

    @torch.no_grad()
    def _remove_floaters(self) -> bool:
        """Remove the Gaussians near one view that no other sees; True if there were some."""
        if self._options.prune_near == 0:
            return False
        floaters = self._gaussians.floaters(self.cameras, self._options.prune_near * self.nearest)
        if not floaters.any():
            return False
        kept = torch.nonzero(~floaters)[:, 0]
        self._optimiser.rebuild(kept, {name: value.detach()[:0] for name, value in self._gaussians.parameters.items()})
        self._gradient_sum, self._visits = self._gradient_sum[kept], self._visits[kept]
        return True

    def _children(self, parents: dict[str, Tensor]) -> dict[str, Tensor]:
        """Two children of each parent, their means drawn from the parent's distribution."""
        children = {name: value.repeat(2, *[1] * (value.ndim - 1)) for name, value in parents.items()}
        children["means"] = children["means"] + self._drawn(children)
        children["log_scales"] = children["log_scales"] - math.log(_SPLIT_SHRINK)
        return children

    def _drawn(self, rows: dict[str, Tensor]) -> Tensor:
        """(N, 3) offsets from the mean, drawn from the distributions of the Gaussians in these rows."""
        scales = rows["log_scales"].exp()
        # The generator is the host's, so that a seed draws the same offsets on every device.
        normal = torch.randn(scales.shape, generator=self._generator, device=self._generator.device)
        return rotate(rows["quaternions"], normal.to(scales.device) * scales)

    @torch.no_grad()
    def _reset_opacity(self) -> None:
        logits = self._gaussians.parameters["opacity_logits"].detach()
        most = torch.full_like(logits, math.log(_RESET_OPACITY / (1 - _RESET_OPACITY)))
        if self._options.reset_filtered and self._gaussians.filter_3d is not None:
            square = (2 * self._gaussians.parameters["log_scales"].detach()).exp()
            # The filter multiplies opacities by the square root of the ratio of the determinants.
            kept = (square / (square + self._gaussians.filter_3d[:, None] ** 2)).prod(dim=1).sqrt()
            most = torch.logit((_RESET_OPACITY / kept).clamp(max=1))
        self._optimiser.replace("opacity_logits", torch.minimum(logits, most))


def rotate(quaternions: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors (N, 3) by quaternions (N, 4), w first, of any non-zero length."""
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    w, axis = unit[:, :1], unit[:, 1:]
    twice = 2 * torch.linalg.cross(axis, vectors)
    return vectors + w * twice + torch.linalg.cross(axis, twice)
