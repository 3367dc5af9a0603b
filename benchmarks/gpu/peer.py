"""gsplat's rasteriser with this project's settings, for `measure.py`, where it is installed."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from benchmarks.gpu.calls import Call, Size, gaussians, rasterize

NEAR, FILTER = 0.2, 0.1  # this project's near plane, scene units, and 2D filter, px**2


def gsplat(size: Size) -> Call:
    """Colour, opacity and expected depth of the image that `calls.rasterize` draws.

    Raises ImportError where gsplat isn't installed, or its CUDA part isn't there.
    """
    from gsplat import rasterization

    parameters, camera = gaussians(size)

    def run(*inputs: Tensor) -> list[Tensor]:
        means, log_scales, quaternions, logits, dc, rest = inputs
        intrinsics = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        pose = torch.tensor(camera.world_to_camera, dtype=means.dtype, device=means.device)
        drawn, alpha, _ = rasterization(
            means, quaternions, log_scales.exp(), logits.sigmoid(), torch.cat([dc[:, None], rest], 1), pose[None],
            torch.tensor([intrinsics], dtype=means.dtype, device=means.device), camera.width, camera.height,
            near_plane=NEAR, eps2d=FILTER, sh_degree=3, render_mode="RGB+ED", rasterize_mode="antialiased",
        )  # fmt: skip
        return [drawn[0, ..., :3], alpha[0, ..., 0], drawn[0, ..., 3]]

    return Call(tuple(parameters), run)


def without_depth(call: Call) -> Call:
    """The call's colour and opacity alone: gsplat's depth of a Gaussian is its centre's, this project's its plane's."""
    return replace(call, run=lambda *inputs: call.run(*inputs)[:2])


def both(size: Size) -> tuple[Call, Call]:
    """(this project's, gsplat's) colour and opacity. Raises ImportError as `gsplat` does."""
    peer = gsplat(size)
    return without_depth(rasterize(size)), without_depth(peer)
