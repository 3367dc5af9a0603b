"""A depth network tuned to one scene (DoF-Gaussian, section 4.2, Eq. 8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import InputError
from dofbench.training.common.priors.network_prior import fixed_threads, network_input, run
from dofbench.training.common.priors.prior_progress import Progress, silent
from dofbench.training.common.supervision import DepthMap, sparse_depth

BATCH = 5
RATE, DECAY = 4e-4, 0.1  # Adam's learning rate, and the factor by which it falls over the whole tuning


def scale_invariant_loss(predicted: Tensor, target: Tensor, weight: Tensor, form: str) -> Tensor:
    """Eq. 8 over a batch of log depths (B, 1, H, W), weighted, with the best scale of each view.

    "squared" is the printed form: mean (log D^ + s - log D)^2, where the s that minimises it is the
    mean of log D - log D^, so it needn't be learned. "absolute" is the released form: the mean of the
    absolute difference after the same shift.
    """
    axes = (1, 2, 3)
    whole = weight.sum(axes, keepdim=True).clamp_min(1e-12)
    difference = target - predicted
    shift = (weight * difference).sum(axes, keepdim=True) / whole
    residual = difference - shift
    error = residual.square() if form == "squared" else residual.abs()
    seen = (weight.sum(axes) > 0).to(error.dtype)
    return ((weight * error).sum(axes) / whole[:, 0, 0, 0]).sum() / seen.sum().clamp_min(1)


def tune(
    network: nn.Module,
    training_set: TrainingSet,
    known: Sequence[DepthMap],
    *,
    steps: int,
    loss: str,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Train the network, in place, to predict from the photographs their known depth and the sparse points' depth.

    Raises FloatingPointError at the first loss that isn't finite, InputError for a network that can't be trained, or if
    no view has known depth.
    """
    parameters = [parameter for parameter in network.parameters() if parameter.requires_grad]
    if not parameters:
        raise InputError("option depth_prior_file", "a network without trainable parameters", "some to tune")
    images = torch.stack([network_input(view.image) for view in training_set.views])
    targets = [_target(training_set, index, known[index], images.shape[2:]) for index in range(len(images))]
    log_depth, weight = (torch.stack(values) for values in zip(*targets, strict=True))
    if not bool((weight > 0).any()):
        raise InputError("option depth_prior", "no depth in any view to tune the network by", "some stereo or points")
    optimiser = torch.optim.Adam(parameters, RATE)
    random = np.random.default_rng(seed)
    order: list[int] = []
    with fixed_threads():
        for step in range(steps):
            progress("depth prior: tuning", step, steps)
            for group in optimiser.param_groups:
                group["lr"] = RATE * DECAY ** (step / (steps + 1))
            while len(order) < min(BATCH, len(images)):
                order += random.permutation(len(images)).tolist()
            batch, order = order[:BATCH], order[BATCH:]
            names = ", ".join(training_set.views[index].name for index in batch)
            predicted = run(network, images[batch], names)
            value = scale_invariant_loss(predicted, log_depth[batch], weight[batch], loss)
            if not bool(torch.isfinite(value)):
                raise FloatingPointError(f"views {names}: loss is {float(value.detach())} at tuning step {step + 1}")
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            optimiser.step()
    progress("depth prior: tuning", steps, steps)


def _target(training_set: TrainingSet, index: int, known: DepthMap, size: torch.Size) -> tuple[Tensor, Tensor]:
    """Log depth and weight, (1, h, w) each, at the network's size, stretched as the photograph is.

    Of several depths in one pixel the last is taken, since a mean across an outline would lie on no surface.
    """
    view = training_set.views[index]
    samples = [known.samples(view.camera)]
    if training_set.points is not None:
        samples.append(sparse_depth(training_set.points, view.camera, index))
    log_depth, weight = torch.zeros(1, *size), torch.zeros(1, *size)
    for one in samples:
        rows = (one.rows + 0.5).mul(size[0] / view.camera.height).long()
        columns = (one.columns + 0.5).mul(size[1] / view.camera.width).long()
        flat = (rows * size[1] + columns).numpy()
        # numpy guarantees that the last of several writes to one element counts; torch doesn't.
        log_depth.numpy().reshape(-1)[flat] = np.log(one.depth.numpy())
        weight.numpy().reshape(-1)[flat] = 1.0 if one.weight is None else one.weight.numpy()
    return log_depth, weight
