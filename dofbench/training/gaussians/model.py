"""The Gaussians of a scene: parameters, initialisation from points, the 3D filter, saving."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.files import replacing
from dofbench.core.lens import DisparityRange
from dofbench.core.readable import read_arrays
from dofbench.runtime.device_numbers import beside

SH_C0 = 0.5 / math.sqrt(math.pi)  # value of the constant spherical harmonic
INITIAL_OPACITY = 0.1  # 3DGS
FILTER_3D_VARIANCE = 0.2  # Mip-Splatting, section 4.1: sampling interval to standard deviation
NEAR = 0.2  # 3DGS: Gaussians that aren't farther than this from a camera aren't drawn; scene units
LEAST_SPACING = 0.01  # of the median distance between points; 3DGS has 3e-4 scene units, which are arbitrary
NEAREST_SHARE = 4  # the near plane is at most this part of the distance of the nearest surfaces

_SAVED = "saved Gaussians (.npz)"
PARAMETERS = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")


class Gaussians:
    """N Gaussians, float32, as the optimiser sees them.

    means (N, 3) scene units; log_scales (N, 3); quaternions (N, 4), w first, any length; opacity_logits (N,); sh_dc
    (N, 3); sh_rest (N, K - 1, 3); filter_3d (N,) scene units or None. near: z, scene units, up to which nothing is
    drawn.
    """

    def __init__(self, parameters: dict[str, Tensor], filter_3d: Tensor | None = None, near: float = NEAR):
        self.parameters = {name: parameters[name].detach().contiguous().requires_grad_() for name in PARAMETERS}
        self.filter_3d, self.near = filter_3d, near

    def __len__(self) -> int:
        return len(self.parameters["means"])

    @property
    def max_sh_degree(self) -> int:
        """Highest spherical-harmonics degree that sh_rest has room for."""
        return math.isqrt(self.parameters["sh_rest"].shape[1] + 1) - 1

    def on(self, device: torch.device | str) -> Gaussians:
        """The Gaussians on a device, as new parameters."""
        filter_3d = None if self.filter_3d is None else self.filter_3d.to(device)
        return Gaussians({name: value.to(device) for name, value in self.parameters.items()}, filter_3d, self.near)

    @staticmethod
    def from_points(points: PointCloud | None, sh_degree: int, device: torch.device | str = "cpu") -> Gaussians:
        """One Gaussian a point, with its colour, and the scale from its three nearest neighbours (3DGS).

        Neighbours count as at least `LEAST_SPACING` of the median distance away, so that coinciding points have a size
        too. Raises InputError when there are fewer than four points, or all coincide.
        """
        from scipy.spatial import cKDTree

        if points is None or len(points) < 4:
            raise InputError("sparse points", f"{0 if points is None else len(points)}", "at least 4 to start from")
        distances, _ = cKDTree(points.xyz).query(points.xyz, k=4, workers=-1)
        mean_square = (distances[:, 1:] ** 2).mean(axis=1)
        if not mean_square.any():
            raise InputError("sparse points", "all at the same place", "at least two places to start from")
        mean_square = np.maximum(mean_square, LEAST_SPACING**2 * np.median(mean_square[mean_square > 0]))
        count = len(points)
        scales = torch.from_numpy(0.5 * np.log(mean_square)).float().to(device)
        quaternions = torch.zeros(count, 4, device=device)
        quaternions[:, 0] = 1.0
        colours = torch.from_numpy(np.asarray(points.rgb, dtype=np.float32)).to(device)
        return Gaussians(
            {
                "means": torch.from_numpy(points.xyz).float().to(device),
                "log_scales": scales[:, None].repeat(1, 3),
                "quaternions": quaternions,
                "opacity_logits": torch.full(
                    (count,), math.log(INITIAL_OPACITY / (1 - INITIAL_OPACITY)), device=device
                ),
                "sh_dc": (colours - 0.5) / SH_C0,
                "sh_rest": torch.zeros(count, (sh_degree + 1) ** 2 - 1, 3, device=device),
            }
        )

    @torch.no_grad()
    def update_filter_3d(self, cameras: Sequence[Camera]) -> None:
        """Compute Mip-Splatting's 3D filter, (N,) scene units, from the finest sampling of the views of each Gaussian.

        A view sees a Gaussian in front of it that projects at most 15 % outside the image. A Gaussian that no view sees
        gets the largest size of the others. Raises InputError if no Gaussian is seen.
        """
        means = self.parameters["means"].detach()
        finest = means.new_full((len(means),), math.inf)
        for camera in cameras:
            seen, depth = self._seen(camera)
            size = depth / max(camera.fx, camera.fy) * math.sqrt(FILTER_3D_VARIANCE)
            finest = torch.where(seen, torch.minimum(finest, size), finest)
        # One more number, so that there is a maximum without any Gaussians.
        sizes = torch.cat([torch.where(torch.isinf(finest), -math.inf, finest), means.new_full((1,), -math.inf)])
        largest = sizes.max()
        if math.isinf(float(largest)):
            raise InputError("cameras", "no Gaussian in front of any of them", "cameras that see the points")
        self.filter_3d = torch.minimum(finest, largest)

    @torch.no_grad()
    def floaters(self, cameras: Sequence[Camera], within: float) -> Tensor:
        """(N,) bool: the Gaussians that one of these cameras alone sees, as for the 3D filter, nearer than `within`,
        scene units."""
        counts = torch.zeros(len(self), dtype=torch.int64, device=self.parameters["means"].device)
        near = counts > 0
        for camera in cameras:
            seen, depth = self._seen(camera)
            counts += seen
            near |= seen & (depth < within)
        return (counts == 1) & near

    def _seen(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """(N,) bool and (N,): whether a camera sees each Gaussian, and its z in the camera's frame, scene units."""
        means = self.parameters["means"].detach()
        world_to_camera = beside(means, camera.world_to_camera)
        local = means @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
        depth = local[:, 2]
        u, v = camera.pixels(local[:, 0], local[:, 1], depth)
        w, h = camera.width, camera.height
        return (depth > self.near) & (u > -0.15 * w) & (u < 1.15 * w) & (v > -0.15 * h) & (v < 1.15 * h), depth

    def save(self, path: Path) -> None:
        """Write all parameters bit for bit as a compressed NumPy archive, atomically."""
        arrays = {name: value.numpy(force=True) for name, value in self.parameters.items()}
        arrays["near"] = np.array(self.near)
        if self.filter_3d is not None:
            arrays["filter_3d"] = self.filter_3d.numpy(force=True)
        with replacing(path) as temporary:
            np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]  # no array is called allow_pickle

    @staticmethod
    def load(path: Path) -> Gaussians:
        """Read a file that `save` wrote; raises InputError for any other file."""
        found = read_arrays(path, _SAVED)
        missing = [name for name in PARAMETERS if name not in found]
        if missing:
            raise InputError(path, f"no {', '.join(missing)}", _SAVED)
        near = found.pop("near", np.array(NEAR))
        if near.shape != () or near.dtype.kind != "f" or not 0 < near < math.inf:
            raise InputError(path, f"near of shape {near.shape}, {near.dtype}", _SAVED)
        count = len(found["means"]) if found["means"].ndim else 0
        terms = found["sh_rest"].shape[1] if found["sh_rest"].ndim == 3 else -1
        rows = {"means": (3,), "log_scales": (3,), "quaternions": (4,), "sh_dc": (3,), "sh_rest": (terms, 3)}
        for name in (*PARAMETERS, *(("filter_3d",) if "filter_3d" in found else ())):
            shape = (count, *rows.get(name, ()))
            if found[name].shape != shape or found[name].dtype != np.float32:
                kind = f"{name} of shape {found[name].shape}, {found[name].dtype}"
                raise InputError(path, kind, f"{_SAVED}: shape {shape}, float32")
        arrays = {name: torch.from_numpy(array) for name, array in found.items()}
        return Gaussians(arrays, arrays.get("filter_3d"), float(near))


def near_plane(sparse: DisparityRange, share: float = 0.0) -> float:
    """The near plane of a scene, scene units: at `share` of the distance of the nearest sparse points; with 0 3DGS's,
    or nearer if the sparse points reach so near. The unit of a reconstruction is arbitrary, and a macro scene in
    metres is within 3DGS's near plane as a whole."""
    return share / sparse.q_max if share > 0 else min(NEAR, 1 / (NEAREST_SHARE * sparse.q_max))


def scene_extent(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from the mean camera (3DGS); scene units."""
    centres = np.stack([camera.centre for camera in cameras])
    extent = 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    return extent if extent > 0 else 1.0
