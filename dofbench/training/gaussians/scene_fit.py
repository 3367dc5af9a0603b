"""Reconstruct an all-in-focus scene with our own trainer: the dataset builder's depth source `splat`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import Status
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.depth.source import DepthEstimate, SourceId, trust
from dofbench.scenes.scene import Scene, SceneView
from dofbench.training.common.depth import SURFACE_ALPHA
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import SH_C0, Gaussians
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.trainer import Trainer

Progress = Callable[[int, int], None]

# This training is for depth, so the points supervise it, in disparity, in which blur is linear.
OPTIONS = GaussianOptions().with_overrides(
    {
        "lens": False,
        "adaptation": "off",
        "sh_degree": 2,
        "means_lr": 4e-4,
        "means_lr_final": 4e-6,
        "depth_space": "disparity",
        "depth_norm": "l1",
        "depth_weight": 0.2,
        "depth_decay": 0.3,
        "normal_weight": 0.0,
        "coarse_until": 0.15,
        "reset_every": 0.0,
        "densify_from": 0.05,
        "densify_until": 0.6,
        "grow_gradient": 3e-4,
        "clone_opacity": "share",
        "max_gaussians": 150_000,
    }
)

# The order of options in manifests. A dataset's checksum covers its manifest, so making a dataset again must give the
# same bytes; newer options come after these, and only if they aren't at their default.
_LISTED = (
    "steps coarse_until coarse_factor max_gaussians sh_degree sh_every background filter_2d filter_3d means_lr "
    "means_lr_final sh_dc_lr sh_rest_lr opacity_lr scale_lr rotation_lr cooldown_from cooldown_to ssim_weight "
    "held_back clipped_white outlier_views outliers_from colour_per_view colour_lr colour_lr_fall lens lens_gamma "
    "lens_alpha lens_energy lens_range lens_model lens_rings lens_samples_from lens_rings_from lens_blades "
    "lens_rotation lens_per lens_trials lens_trials_at lens_trials_steps lens_activation lens_update lens_lr "
    "lens_lr_final lens_from lens_init_aperture lens_init_focus blur_to_depth depth_weight depth_norm depth_space "
    "depth_decay depth_prior depth_prior_file depth_prior_workspace depth_prior_coarser depth_prior_steps "
    "start_points depth_prior_loss normal_weight normal_from normal_median normal_form distortion_weight "
    "distortion_from distortion_near distortion_far adaptation adaptation_from adaptation_aperture adaptation_a "
    "adaptation_b densify_from densify_until densify_every grow_gradient grow_absolute dense_share clone_opacity "
    "prune_opacity prune_depth_graded reset_every"
).split()


@dataclass(frozen=True, eq=False)
class Surface:
    """depth: (H, W) float32 z in scene units, 0 where nothing was reconstructed. alpha: (H, W). spread: (H, W),
    1 / scene unit, standard deviation of disparity among the pixel's Gaussians."""

    depth: np.ndarray
    alpha: np.ndarray
    spread: np.ndarray


class Reconstruction:
    """A trained all-in-focus scene: depth and alpha at any camera."""

    def __init__(self, gaussians: Gaussians, options: GaussianOptions):
        self.gaussians, self._options = gaussians, options

    @torch.no_grad()
    def surface(self, camera: Camera) -> Surface:
        """The surface of the reconstruction as the camera sees it."""
        raster = rasterise(self.gaussians, camera, self._options.appearance, sh_degree=0)
        assert raster.depth is not None
        # Rendered with disparity and its square as colours, for mean and variance of disparity. Gaussians behind the
        # near plane have none: the unit is the largest disparity, and digits of much smaller values are lost.
        pose = torch.from_numpy(np.array(camera.world_to_camera)).float()
        z = self.gaussians.parameters["means"] @ pose[2, :3] + pose[2, 3]
        disparity = torch.where(z > self.gaussians.near, 1 / z, 0.0)
        unit = float(disparity.max()) or 1.0
        moments = torch.stack([disparity / unit, (disparity / unit) ** 2, torch.zeros_like(z)], dim=1)
        colours = {"sh_dc": (moments - 0.5) / SH_C0}
        painted = Gaussians({**self.gaussians.parameters, **colours}, self.gaussians.filter_3d, self.gaussians.near)
        blended = (
            rasterise(painted, camera, replace(self._options.appearance, background=0.0), sh_degree=0, geometry="none")
            .color.numpy()
            .astype(np.float64)
        )
        alpha = raster.alpha.numpy()
        known = alpha > SURFACE_ALPHA
        mean, square = (
            np.divide(blended[..., channel], alpha, out=np.zeros(alpha.shape), where=known) for channel in (0, 1)
        )
        return Surface(
            np.where(known, raster.depth.numpy(), np.float32(0)), alpha, unit * np.sqrt(np.maximum(square - mean**2, 0))
        )

    def settings(self) -> Mapping[str, Any]:
        """The options of the training, for a manifest."""
        values, usual = self._options.flat(), GaussianOptions().flat()
        new = (name for name in values if name not in _LISTED and values[name] != usual[name])
        return {name: values[name] for name in (*_LISTED, *new)}

    def save(self, path: Path) -> None:
        """Write the Gaussians."""
        self.gaussians.save(path)

    @staticmethod
    def load(path: Path, *, steps: int) -> Reconstruction:
        """Read Gaussians that `save` wrote."""
        return Reconstruction(Gaussians.load(path), OPTIONS.with_overrides({"steps": steps}))


class _ProgressObserver:
    def __init__(self, total: int, progress: Progress | None):
        self._total, self._progress, self._start = total, progress, time.perf_counter()

    def seconds(self) -> float:
        return time.perf_counter() - self._start

    def after_step(self, step: int, loss: float) -> bool:
        if self._progress is not None:
            self._progress(step, self._total)
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""


def reconstruct(
    scene: Scene, *, steps: int, seed: int, progress: Progress | None = None, at_once: int = 1
) -> Reconstruction:
    """Train on all views of an all-in-focus scene, test views too, since the depth is part of a dataset's truth.

    progress: called with (step, steps). at_once: views to read at a time. Raises InputError when the scene has no
    points, and FloatingPointError when training diverges.
    """
    scene.require_points("a Gaussian reconstruction")
    options = OPTIONS.with_overrides({"steps": steps})

    def read(view: SceneView) -> TrainingView:
        return TrainingView(view.name, view.camera, view.image(), mask=None if view.mask is None else view.mask())

    views = tuple(over_views(read, scene.views, at_once))
    trainer = Trainer(TrainingSet(views, scene.unmasked().points), options, seed)
    outcome = trainer.fit(Budget(steps=steps), _ProgressObserver(steps, progress))
    if outcome.status is not Status.OK:
        raise FloatingPointError(f"{scene.root}: reconstruction {outcome.status}: {outcome.message}")
    return Reconstruction(trainer.gaussians, options)


class SplatDepth:
    """The depth source `splat`: rendered from a trained reconstruction, consistent between views, 0 without a
    surface."""

    id: SourceId = "splat"
    confidence = (
        "accumulated opacity, times 1 / (1 + (s / 5 % of the view's disparity range)^2), s the standard deviation of "
        "disparity among the Gaussians that the pixel is blended from"
    )

    def __init__(self, reconstruction: Reconstruction, provenance: dict[str, Any]):
        self._reconstruction, self._provenance = reconstruction, provenance

    @classmethod
    def make(
        cls,
        scene: Scene,
        *,
        steps: int,
        seed: int,
        work: Path,
        progress: Callable[[int, int], None] | None = None,
        at_once: int = 1,
    ) -> SplatDepth:
        """Reconstruct the scene, or load an earlier run's reconstruction from `work`. at_once: views to read at a time.
        Raises InputError without points."""
        path = work / "reconstruction.npz"
        if not path.is_file():
            reconstruction = reconstruct(scene, steps=steps, seed=seed, progress=progress, at_once=at_once)
            reconstruction.save(path)
        # Always from the file, so that a resumed run renders the same numbers as an uninterrupted one.
        reconstruction = Reconstruction.load(path, steps=steps)
        provenance = {
            "from": "a Gaussian reconstruction of the all-in-focus images of all views",
            "steps": steps,
            "seed": seed,
            "options": dict(reconstruction.settings()),
        }
        return cls(reconstruction, provenance)

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth at the view's camera, 0 where nothing was reconstructed."""
        surface = self._reconstruction.surface(view.camera)
        known = surface.depth > 0
        confidence = np.where(known, np.clip(surface.alpha, 0, 1), 0)
        if known.any():
            low, high = np.percentile(1 / surface.depth[known], [5, 95])
            if high > low:
                confidence = confidence * trust(surface.spread / (high - low))
        return DepthEstimate(np.ascontiguousarray(surface.depth, dtype=np.float32), confidence.astype(np.float32))

    def provenance(self) -> dict[str, Any]:
        """Steps, seed and options of the training."""
        return self._provenance
