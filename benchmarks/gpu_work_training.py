"""What a training step does beside its ops: the optimiser, checks, and torch's small operations."""

from __future__ import annotations

from gpu_work import Op, OtherWork

PARAMETERS = 59  # numbers of a Gaussian: mean, scales, quaternion, opacity and 16 coefficients of three colours

# Adam reads parameter, gradient and two moments, and writes all but the gradient. Of each gradient is counted whether
# it is finite, the negation of that, and how often it isn't.
_ADAM, _CHECKED = 28, 8  # bytes a parameter

GAUSSIANS = Op(
    others=(
        # One launch for each parameter.
        OtherWork("Adam", "Adam", True, lambda s: _ADAM * PARAMETERS * s.gaussians, lambda s: 6),
        OtherWork("checks", "Adam", True, lambda s: _CHECKED * PARAMETERS * s.gaussians, lambda s: 36),
        OtherWork("statistics", "Adam", True, lambda s: 60 * s.gaussians, lambda s: 9),
        OtherWork("small operations", "small operations", True, lambda s: 0, lambda s: s.torch_ops),
    )
)

# Pictures seen from points of the lens: their mean in linear light, and its gradient, which is the same for all.
MEAN_OF_POINTS = Op(
    others=(
        OtherWork("mean", "lens forward", False, lambda s: 4 * (s.points + 1) * s.numbers, lambda s: 0),
        OtherWork("mean", "lens backward", True, lambda s: 4 * (s.points + 1) * s.numbers, lambda s: 0),
    )
)
