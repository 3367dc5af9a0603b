"""What torch itself does in a training step beside the ops' kernels: sorts, sums, the optimiser and small operations.

Their machine code isn't looked at: all are taken to be bound by memory, or by their launches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gpu_peaks import SORT_SHARE, WAIT
from gpu_sizes import Sizes
from gpu_work import PARAMETERS, SLOT


@dataclass(frozen=True)
class TorchWork:
    """Operations of torch. op: that calls them, "" for the training step itself. stage, backward: as in
    `gpu_work.Kernel`. moved: bytes. launches: how many kernels. share: of the bandwidth that is reached. wait: seconds
    besides."""

    op: str
    name: str
    stage: str
    backward: bool
    moved: Callable[[Sizes], float]
    launches: Callable[[Sizes], int]
    share: float = 1.0
    wait: float = 0.0


def sorted_bytes(count: float, key: int) -> float:
    """Bytes that a radix sort moves for keys of `key` bytes with their places, 8 bytes each: a histogram of the keys,
    one pass for each byte that reads and writes both, and the places written before."""
    return count * (key + key * 2 * (key + 8) + 8)


def _key(sizes: Sizes) -> int:
    """Bytes of a tile's number, gpu_lists.project_and_list."""
    return 2 if sizes.tiles < 2**15 else 4


TORCH = (
    TorchWork(
        "rasterize", "sort by depth", "sort", False, lambda s: sorted_bytes(s.gaussians, 4), lambda s: 4 + 3, SORT_SHARE
    ),
    TorchWork(
        "rasterize", "sort by tile", "sort", False, lambda s: sorted_bytes(s.pairs, _key(s)), lambda s: _key(s) + 3,
        SORT_SHARE,
    ),
    # Counts in order of depth, their running sum, and its last number, for which the host waits.
    TorchWork("rasterize", "ends", "lists", False, lambda s: 28 * s.gaussians, lambda s: 4, wait=WAIT),
    TorchWork("rasterize", "starts and ids", "lists", False, lambda s: 16 * s.pairs, lambda s: 3),
    TorchWork("rasterize", "zeros", "blend backward", True, lambda s: 4 * SLOT * s.pairs, lambda s: 1),
    TorchWork("scatter", "brightness", "lens forward", False, lambda s: 6 * 12 * s.pixels, lambda s: 14),
    TorchWork("ssim", "means", "loss", False, lambda s: 0, lambda s: 6),
    TorchWork("ssim", "scales", "loss", True, lambda s: 0, lambda s: 6),
    # Adam reads parameter, gradient and two moments, and writes all but the gradient; one launch for each parameter.
    TorchWork("", "Adam", "Adam", True, lambda s: 28 * PARAMETERS * s.gaussians, lambda s: 6),
    # Of each gradient whether it is finite, its negation, and how often it isn't.
    TorchWork("", "checks", "Adam", True, lambda s: 8 * PARAMETERS * s.gaussians, lambda s: 36),
    TorchWork("", "statistics", "Adam", True, lambda s: 60 * s.gaussians, lambda s: 9),
    TorchWork("", "small operations", "small operations", True, lambda s: 0, lambda s: s.torch_ops),
)  # fmt: skip
