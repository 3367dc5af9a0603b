"""Random Gaussians before a camera, for measurements that need many of a given size and no photographs."""

from __future__ import annotations

import numpy as np
import torch

from dofbench.core.cameras import Camera


def scene(n: int, width: int, height: int, pixels: float, seed: int = 0) -> tuple[list[torch.Tensor], Camera]:
    """Random Gaussians, `pixels` wide on average, spread over the image and a little beyond."""
    generator = torch.Generator().manual_seed(seed)
    focal = 1.1 * width
    u, v = (torch.rand(n, generator=generator) * 1.1 - 0.55 for _ in range(2))
    z = 2 + 6 * torch.rand(n, generator=generator)
    scales = torch.log(pixels * z / focal)[:, None] + 0.5 * torch.randn(n, 3, generator=generator)
    parameters = [
        torch.stack([u * width / focal * z, v * height / focal * z, z], 1),
        scales,
        torch.randn(n, 4, generator=generator),
        torch.randn(n, generator=generator) * 1.5 - 0.5,
        torch.randn(n, 3, generator=generator) * 0.5,
        torch.randn(n, 15, 3, generator=generator) * 0.1,
    ]
    return parameters, Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))
