"""Depth priors of a scene, made from a method's inputs (DoF-Gaussian, section 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.masks import PackedMask
from dofbench.core.progress import Update, silent
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.depth_map import DepthMap, DepthSamples
from dofbench.training.common.options import CONTENT

_REACH = 0.01  # of the width: pixels so near to one of known depth count as known
_FEW = 0.05  # share of the pixels: with fewer unknown ones nothing is started behind (docs/notes/points.md)
_FARTHEST = 0.02  # of the nearest known disparity: least one of a point behind it


@dataclass(frozen=True)
class PriorOptions:
    """Which depth supervises the training, and how it is made before training."""

    depth_prior: Literal["sparse", "stereo", "network", "tuned", "colmap"] = "sparse"
    """The depth that supervises: sparse, the sparse points; stereo, our stereo on the photographs, and the points;
    network, a depth network as it is; tuned, a network tuned to the scene by stereo depth and points; colmap, a dense
    workspace of COLMAP's. Unit: none. Source: tuned: section 4.2; others: own."""
    depth_prior_file: str = field(default="", metadata=CONTENT)
    """File of a depth network of your own, ONNX, or torchscript:FILE for TorchScript that you trust: its code runs;
    without it the shipped network is used. Unit: none. Source: own."""
    depth_prior_workspace: str = field(default="", metadata=CONTENT)
    """COLMAP's dense folder: required by colmap; with tuned it replaces stereo. Unit: none. Source: released code."""
    depth_prior_coarser: int = 0
    """How many times stereo is repeated at half the previous size, to fill pixels without depth. Unit: none. Source:
    own."""
    depth_prior_steps: int = 150
    """Steps of tuning the network, at most as many as the training's steps. Unit: steps. Source: released code."""
    start_points: int = 0
    """How many points on the prior's surfaces the Gaussians start from, in addition to the sparse points (not possible
    with sparse). Independent of depth_weight. Unit: points. Source: own."""
    start_behind: float = 0.0
    """How many points the Gaussians start from where the prior knows no depth, if it knew none anywhere: behind the
    nearest pixel of known depth, evenly in disparity down to near infinity. Unit: start_points. Source: own."""
    depth_prior_loss: Literal["squared", "absolute"] = "squared"
    """Loss of tuning; both forms use the best scale of each view. Unit: none. Source: squared: Eq. 8; absolute:
    released code."""

    def __post_init__(self) -> None:
        for name in ("depth_prior_coarser", "start_behind"):
            if getattr(self, name) < 0:
                raise InputError(f"option {name}", f"{getattr(self, name):g}", "at least 0")

    @property
    def matches_views(self) -> bool:
        """Whether the prior needs stereo on the views."""
        return self.depth_prior in ("stereo", "tuned") and not self.depth_prior_workspace


class Prior(Protocol):
    """Known depth of every training view, such as `SparsePrior` and `DensePrior`."""

    def samples(self, index: int, camera: Camera) -> DepthSamples:
        """The known depth of training view `index` in the pixels of `camera`, the view's at any size."""

    def kept(self, index: int, camera: Camera) -> DepthMap | DepthSamples:
        """The same as it is kept for a training: a map, or a few samples."""


@dataclass(frozen=True, eq=False)
class SparsePrior:
    """The sparse points alone."""

    points: PointCloud

    def samples(self, index: int, camera: Camera) -> DepthSamples:
        return sparse_depth(self.points, camera, index)

    def kept(self, index: int, camera: Camera) -> DepthSamples:
        return self.samples(index, camera)


@dataclass(frozen=True, eq=False)
class DensePrior:
    """One depth map per training view."""

    maps: Sequence[DepthMap]

    def samples(self, index: int, camera: Camera) -> DepthSamples:
        return self.maps[index].samples(camera)

    def kept(self, index: int, camera: Camera) -> DepthMap:
        return self.maps[index].resized(camera)


def make_prior(
    training_set: TrainingSet,
    options: PriorOptions,
    *,
    seed: int,
    steps: int,
    device: str = "cpu",
    progress: Update = silent,
) -> Prior:
    """Make the prior of the options. steps: of the training, the most that a network is tuned. device: of stereo;
    networks run on the CPU. progress: called for every view and every step of tuning.

    Raises InputError for a file that is missing or wrong, and FloatingPointError when tuning diverges.
    """
    _check_files(options)
    points = training_set.points
    if options.depth_prior == "sparse":
        if points is None:
            raise InputError("option depth_prior", "sparse for a training set without points", "stereo needs them too")
        return SparsePrior(points)

    # Imported where they are used: some need heavy modules.
    def semi_dense() -> list[DepthMap]:
        if options.depth_prior_workspace:
            from dofbench.training.common.priors.patch_match import workspace_depth

            return workspace_depth(Path(options.depth_prior_workspace), training_set, progress=progress)
        from dofbench.training.common.priors.stereo import stereo_depth

        return stereo_depth(training_set, coarser=options.depth_prior_coarser, device=device, progress=progress)

    if options.depth_prior == "colmap":
        return DensePrior(semi_dense())
    if options.depth_prior == "stereo":
        maps = semi_dense()
        assert points is not None  # `stereo_depth` refuses a training set without points
        # Sparse points replace stereo depth in their pixels: matched at corners in several views, they are more exact.
        # One map after the other, so that not all are there twice.
        for index, view in enumerate(training_set.views):
            maps[index] = maps[index].with_samples(sparse_depth(points, view.camera, index))
        return DensePrior(maps)
    from dofbench.training.common.priors.network import open_network, predicted_depth, tune

    network = open_network(options.depth_prior_file, training_set)
    if options.depth_prior == "network":
        return DensePrior(predicted_depth(network, training_set, None, progress=progress))
    known = semi_dense()
    tune(
        network,
        training_set,
        known,
        steps=min(options.depth_prior_steps, steps),
        loss=options.depth_prior_loss,
        seed=seed,
        progress=progress,
    )
    return DensePrior(predicted_depth(network, training_set, known, progress=progress))


def with_surface_points(training_set: TrainingSet, prior: Prior, count: int, seed: int) -> PointCloud:
    """The sparse points, and about `count` points on the prior's surfaces, as many from each view, drawn by weight.

    Raises InputError for the sparse prior, which has no other points.
    """
    points = training_set.points
    if isinstance(prior, SparsePrior) or points is None:
        raise InputError("option start_points", f"{count} with depth_prior sparse", "0, or a prior with surfaces")
    random = np.random.default_rng(seed)
    xyz, rgb = [points.xyz], [points.rgb]
    for index, view in enumerate(training_set.views):
        camera, samples = view.camera, prior.samples(index, view.camera)
        if view.mask is not None:
            samples = samples.within(torch.from_numpy(view.mask))
        depth = samples.depth.numpy().astype(np.float64)
        weight = np.ones(len(depth)) if samples.weight is None else samples.weight.numpy().astype(np.float64)
        wanted = min(len(depth), -(-count // len(training_set.views)))
        chosen = np.zeros(0, np.int64)
        if wanted:
            chosen = np.sort(random.choice(len(depth), wanted, replace=False, p=weight / weight.sum()))
        rows, columns, z = samples.rows.numpy()[chosen], samples.columns.numpy()[chosen], depth[chosen]
        xyz.append(camera.lifted(columns, rows, z))
        rgb.append(view.image[rows, columns])
    every, colours = np.concatenate(xyz), np.concatenate(rgb).astype(np.float32)
    return PointCloud(every, colours, np.full(len(every), np.nan, np.float32))


def with_points_behind(
    training_set: TrainingSet, points: PointCloud, prior: Prior, count: int, seed: int
) -> PointCloud:
    """`points`, and points on the rays of the training views for which the prior knows no depth.

    What is blurred in every photograph has neither features nor stereo, so that nothing would start there, and
    densification reaches no far background. A drawn pixel gets its own colour, and a disparity between near infinity
    and that of the nearest pixel of known depth. count: if no pixel had known depth; in proportion else.
    """
    from scipy.ndimage import distance_transform_edt

    random = np.random.default_rng([seed, 1])
    xyz, rgb = [points.xyz], [points.rgb]
    unknowns, shares = list[PackedMask](), list[float]()
    for index, view in enumerate(training_set.views):
        unknown = _unknown(_disparities(prior, index, view), view)
        unknowns.append(PackedMask.of(unknown))
        shares.append(float(unknown.mean()))
    if np.mean(shares) < _FEW:
        return points
    for index, view in enumerate(training_set.views):
        rows, columns = np.nonzero(unknowns[index].bools())
        wanted = min(len(rows), round(count / len(training_set.views) * shares[index]))
        if wanted == 0:
            continue
        disparity = _disparities(prior, index, view)
        nearest = distance_transform_edt(disparity == 0, return_distances=False, return_indices=True)
        chosen = np.sort(random.choice(len(rows), wanted, replace=False))
        rows, columns = rows[chosen], columns[chosen]
        limit = disparity[tuple(nearest[:, rows, columns])]
        z = 1 / (limit * random.uniform(_FARTHEST, 1.0, wanted))
        xyz.append(view.camera.lifted(columns, rows, z))
        rgb.append(view.image[rows, columns])
    every, colours = np.concatenate(xyz), np.concatenate(rgb).astype(np.float32)
    return PointCloud(every, colours, np.full(len(every), np.nan, np.float32))


def _disparities(prior: Prior, index: int, view: TrainingView) -> np.ndarray:
    """(H, W) disparity that the prior knows of a view, 1 / scene unit; 0 where it knows none."""
    samples = prior.samples(index, view.camera)
    disparity = np.zeros((view.camera.height, view.camera.width))
    disparity[samples.rows.numpy(), samples.columns.numpy()] = 1 / samples.depth.numpy()
    return disparity


def _unknown(disparity: np.ndarray, view: TrainingView) -> np.ndarray:
    """(H, W) bool: valid pixels without a pixel of known depth nearby; none where no depth is known at all."""
    from scipy.ndimage import binary_dilation

    if not disparity.any():
        return np.zeros(disparity.shape, bool)
    reach = max(1, round(_REACH * view.camera.width))
    known = binary_dilation(disparity > 0, np.ones((2 * reach + 1, 2 * reach + 1)))
    return np.asarray(~known if view.mask is None else ~known & view.mask)


def _check_files(options: PriorOptions) -> None:
    """Raise InputError if a file is missing, or given and not read."""
    prior = options.depth_prior
    if prior == "colmap" and not options.depth_prior_workspace:
        raise InputError("option depth_prior_workspace", "none", "COLMAP's dense folder, as depth_prior is colmap")
    for name, readers in (("depth_prior_workspace", ("colmap", "tuned")), ("depth_prior_file", ("network", "tuned"))):
        if getattr(options, name) and prior not in readers:
            raise InputError(f"option {name}", getattr(options, name), f"none, as depth_prior {prior} doesn't read it")
