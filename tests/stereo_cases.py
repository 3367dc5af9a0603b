"""What the tests of plane-sweep stereo share: images with cameras, depth maps, and what is refused."""

from __future__ import annotations

import torch
from tolerances import FLOAT32_GRADIENT
from torch import Tensor

PENALTIES = {"small": 0.05, "large": 0.5, "edge": 0.1}
LIMITS = {"pixels": 4.0, "share": 0.4}

# Changes of the images, maps and disparities of two sources, and what the message says.
REFUSED = [
    (lambda r, s, m, d: (r[0], s, m, d), r"\(H, W\)"),
    (lambda r, s, m, d: (r, s, m[:1], d), r"maps \(2, 3, 4\)"),
    (lambda r, s, m, d: (r, s, m, d[None]), r"disparities \(D,\)"),
]


def case(height: int, width: int, sources: int, planes: int, seed: int):
    """Images and nearly rectified cameras that look a little aside, so that some pixels fall outside.

    No three pixels in a row are alike, nor are samples between them: float32 loses the correlation of flat patches.
    """
    random = torch.Generator().manual_seed(seed)
    level = 2 * torch.arange(height)[:, None] + 3 * torch.arange(width) + torch.arange(sources + 1)[:, None, None]
    images = 0.2 * (level % 5) + 0.1 * torch.rand(sources + 1, height, width, generator=random)
    spread = torch.tensor([[1.0, 1, 50], [1, 1, 50], [1e-3, 1e-3, 1]])
    maps = torch.zeros(sources, 3, 4, dtype=torch.float64)
    for one in maps:
        one[:, :3] = torch.eye(3) + 0.02 * torch.randn(3, 3, generator=random) * spread
        one[:, 3] = torch.randn(3, generator=random) * torch.tensor([10.0, 10.0, 0.01])
    return images[0], images[1:], maps, torch.linspace(0.1, 1.0, planes)


def share_of_differing(found: Tensor, expected: Tensor) -> float:
    """Share of the scores that differ by more than the tolerance: at the border of a source float32 may fall on the
    other side."""
    return float(((found - expected).abs() > FLOAT32_GRADIENT).float().mean())


def shifted(height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    """(image, sources, maps): a plane at disparity 3 moves the image by three pixels, whatever its brightness and
    contrast."""
    image = torch.rand(height, width, generator=torch.Generator().manual_seed(0))
    maps = torch.eye(3, 4)[None].clone()
    maps[0, 0, 3] = 1.0
    return image, (0.3 + 0.4 * torch.roll(image, 3, dims=1))[None], maps


def depths(height: int, width: int, seed: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(depth, other, there, back): maps of two views of different sizes, with unknown pixels, and matrices between
    them."""
    random = torch.Generator().manual_seed(seed)
    depth = torch.rand(height, width, generator=random) + 0.6
    other = torch.rand(height + 1, width + 2, generator=random) + 0.6
    depth[depth > 1.5], other[other > 1.5] = 0, 0
    there, back = (
        torch.eye(3, 4, dtype=torch.float64) + 0.1 * torch.randn(3, 4, generator=random).double() for _ in range(2)
    )
    return depth, other, there, back


def plane_beside() -> tuple[Tensor, Tensor, Tensor]:
    """(depth, there, back): a plane at depth 2, and a camera two pixels of disparity beside."""
    there, back = torch.eye(3, 4, dtype=torch.float64), torch.eye(3, 4, dtype=torch.float64)
    there[0, 3], back[0, 3] = 4.0, -4.0
    return torch.full((5, 9), 2.0), there, back
