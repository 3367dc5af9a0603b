"""What a training step does beside its ops: the optimiser, checks, and torch's small operations."""

from __future__ import annotations

from gpu_work import Kernel, Op, OtherWork, blocks

PARAMETERS = 59  # numbers of a Gaussian: mean, scales, quaternion, opacity and 16 coefficients of three colours

# Adam reads parameter, gradient and two moments, and writes all but the gradient. The largest magnitude of a gradient
# says whether all of it is finite.
_ADAM, _CHECKED = 28, 4  # bytes a parameter

GAUSSIANS = Op(
    (
        # All parameters of the Gaussians, which one launch moves.
        Kernel(
            "adam", "update", "Adam", True, blocks(lambda s: PARAMETERS * s.gaussians, 1024),
            lambda s, _: _ADAM * PARAMETERS * s.gaussians,
        ),
    ),
    others=(
        OtherWork("Adam of lenses and colours", "Adam", True, lambda s: 0, lambda s: 2),
        OtherWork("checks", "Adam", True, lambda s: _CHECKED * PARAMETERS * s.gaussians, lambda s: 8),
        # Five small operations of torch, which are counted with the others below.
        OtherWork("statistics", "Adam", True, lambda s: 50 * s.gaussians, lambda s: 0),
        OtherWork("small operations", "small operations", True, lambda s: 0, lambda s: s.torch_ops),
    ),
)  # fmt: skip

# Pictures seen from points of the lens: their mean in linear light, and its gradient, which is the same for all.
MEAN_OF_POINTS = Op(
    others=(
        OtherWork("mean", "lens forward", False, lambda s: 4 * (s.points + 1) * s.numbers, lambda s: 0),
        OtherWork("mean", "lens backward", True, lambda s: 4 * (s.points + 1) * s.numbers, lambda s: 0),
    )
)
