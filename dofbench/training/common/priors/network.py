"""Depth by a monocular network, shipped or from a file, as it is or tuned to the scene (DoF-Gaussian, Eq. 8).

An ONNX file comes with the side file that `scenes.depth.network` describes, and none of its code runs. It can be tuned
if it has the weights of the shipped network's layers. A TorchScript file holds code that runs with the user's rights,
so it is loaded only as torchscript:FILE. Input (B, 3, H, W) float32 RGB in [0, 1], H and W multiples of 32; output (B,
1, H, W), the logarithm of z-depth up to one constant a view. To be tuned, its parameters must require gradients.
Networks run in evaluation mode: statistics of batch normalisation don't change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.images import resize
from dofbench.core.progress import Update, silent
from dofbench.scenes.depth.align import UNALIGNED, Alignment, fit
from dofbench.scenes.depth.depthnet import MEAN, MULTIPLE, STD, load_folded
from dofbench.scenes.depth.network import Network, find_network, sampled, side_file
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.depth_map import DepthMap
from dofbench.training.common.options import TORCHSCRIPT

SHIPPED = "depthnet"
LONGEST = 256  # px, longer side of the network's input
THREADS = 1  # torch's threads: the bits of a convolution's gradient depend on their number
BATCH = 5  # views of a tuning step
RATE, DECAY = 4e-4, 0.1  # Adam's learning rate, and the factor by which it falls over the whole tuning
_FLOOR = 1e-3  # least disparity, as a share of the scene's median


class LogDepth(nn.Module):
    """A network of log depth from one of relative disparity: -log of the positive part of scale * output + shift.

    unit: the disparity, 1 / scene unit, of an output of 1. scale and shift are tuned too.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, network: nn.Module, scale: float, shift: float, unit: float):
        super().__init__()
        self.network, self.unit = network, unit
        self.scale, self.shift = (nn.Parameter(torch.tensor(value)) for value in (scale, shift))
        self.register_buffer("mean", torch.tensor(MEAN).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor(STD).view(1, 3, 1, 1))

    def forward(self, image: Tensor) -> Tensor:
        """(B, 3, H, W) in [0, 1] to (B, 1, H, W)."""
        disparity = self.scale * self.network((image - self.mean) / self.std) + self.shift
        # A smooth positive part: nearly the disparity itself above a tenth of the unit, and positive below.
        return -torch.log((functional.softplus(disparity, beta=20) + _FLOOR) * self.unit)


class AlignedOnnx(nn.Module):
    """A network of log depth from any ONNX network, by one alignment for the whole scene; it can't be tuned.

    unit: the median disparity of the scene's points, 1 / scene unit; disparity is cut at `_FLOOR` and 1 / `_FLOOR` of
    it.
    """

    def __init__(self, network: Network, alignment: Alignment, unit: float):
        super().__init__()
        self._network, self._alignment, self._unit = network, alignment, unit

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) in [0, 1] to (B, 1, H, W)."""
        found = []
        for image in images:
            output = self._network.predict(image.permute(1, 2, 0).numpy(), "a training view")
            disparity = self._alignment.disparity(output, self._network.description.output)
            cut = np.clip(disparity, _FLOOR * self._unit, self._unit / _FLOOR).astype(np.float32)
            found.append(torch.from_numpy(cut)[None])
        whole = [
            functional.interpolate(one[None], images.shape[2:], mode="bilinear", align_corners=False) for one in found
        ]
        return -torch.log(torch.cat(whole))


def open_network(name: str, training_set: TrainingSet) -> nn.Module:
    """Open a network of log depth, scaled to the scene's disparities; "" is the shipped one. Raises InputError for a
    file that isn't such a network."""
    if name.startswith(TORCHSCRIPT):
        return _scripted(Path(name.removeprefix(TORCHSCRIPT)))
    file = Path(name) if name else find_network(SHIPPED)
    if not file.is_file():
        raise InputError(file, "no such file", "an ONNX network")
    if file.suffix.lower() != ".onnx":
        expected = f"NETWORK.onnx, or {TORCHSCRIPT}{file} if you trust whoever made it: its code runs on this machine"
        raise InputError(file, "no ONNX network by its name", expected)
    try:
        network = load_folded(file).eval()
    except InputError:
        if not name:
            raise
        return _aligned(Network(file), training_set).eval()
    unit, scale, shift = _scene_scale(network, training_set)
    return LogDepth(network, scale, shift, unit).eval()


def input_size(width: int, height: int) -> tuple[int, int]:
    """(width, height) of the network's input: at most LONGEST, and multiples of its stride."""
    share = min(1.0, LONGEST / max(width, height))
    across, down = (max(MULTIPLE, round(side * share / MULTIPLE) * MULTIPLE) for side in (width, height))
    return across, down


def network_input(image: np.ndarray) -> Tensor:
    """The network's input (3, h, w) from an image (H, W, 3)."""
    width, height = input_size(image.shape[1], image.shape[0])
    small = np.clip(resize(image, width, height), 0, 1)
    return torch.from_numpy(np.ascontiguousarray(small.transpose(2, 0, 1), dtype=np.float32))


@contextmanager
def fixed_threads() -> Iterator[None]:
    """Let torch use `THREADS` threads in the block, for the same result on every machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def predicted_depth(
    network: nn.Module, training_set: TrainingSet, known: Sequence[DepthMap] | None, *, progress: Update = silent
) -> list[DepthMap]:
    """Predict a depth map for every view, scaled by the median ratio of its known depth to the network's, if any.

    known: semi-dense depth per view; None for the sparse points alone. Raises FloatingPointError for depth that isn't
    finite.
    """
    maps = []
    for index, view in enumerate(training_set.views):
        progress("depth prior: network", index, len(training_set.views))
        with fixed_threads(), torch.no_grad():
            output = run(network, network_input(view.image)[None], view.name)
            size = view.camera.height, view.camera.width
            depth = torch.exp(functional.interpolate(output, size, mode="bilinear", align_corners=False))[0, 0].numpy()
        if not (np.isfinite(depth).all() and (depth > 0).all()):
            raise FloatingPointError(f"view {view.name}: the network's depth isn't finite")
        samples = known[index].samples(view.camera) if known is not None else None
        if (samples is None or not len(samples.depth)) and training_set.points is not None:
            samples = sparse_depth(training_set.points, view.camera, index)
        if samples is not None and len(samples.depth):
            ratio = samples.depth.numpy() / depth[samples.rows.numpy(), samples.columns.numpy()]
            depth = depth * np.float32(np.median(ratio))
        maps.append(DepthMap(depth, None))
    progress("depth prior: network", len(maps), len(maps))
    return maps


def run(network: nn.Module, images: Tensor, name: str) -> Tensor:
    """Run the network: (B, 3, H, W) to (B, 1, H, W). Raises InputError for an output of another shape."""
    try:
        output = network(images)
    except RuntimeError as error:
        reason = (str(error).strip().splitlines() or ["failed"])[-1]
        raise InputError(
            "option depth_prior_file", f"a network that fails on view {name} ({reason})", "one that takes (B, 3, H, W)"
        ) from None
    if not isinstance(output, Tensor) or output.shape != (len(images), 1, *images.shape[2:]):
        found = tuple(output.shape) if isinstance(output, Tensor) else type(output).__name__
        raise InputError(
            "option depth_prior_file", f"output {found} for input {tuple(images.shape)}", "log depth (B, 1, H, W)"
        )
    return output


def _scripted(file: Path) -> nn.Module:
    if not file.is_file():
        raise InputError(file, "no such file", "a TorchScript network")
    try:
        return torch.jit.load(str(file), map_location="cpu").eval()
    except (RuntimeError, ValueError) as error:
        reason = (str(error).strip().splitlines() or ["unreadable"])[0]
        raise InputError(file, f"no readable network ({reason[:120]})", "a TorchScript network") from None


def _aligned(network: Network, training_set: TrainingSet) -> AlignedOnnx:
    """The network with one alignment to the sparse points of all views, as its side file says."""
    output, disparity = _at_points(
        training_set, lambda image, name: network.predict(image.permute(1, 2, 0).numpy(), name)
    )
    unit = float(np.median(disparity)) if len(disparity) else 1.0
    meaning, freedom = network.description.output, network.description.align
    if freedom == "none":
        return AlignedOnnx(network, UNALIGNED, unit)
    found = fit(output, disparity / unit, np.ones(len(output)), meaning, freedom)
    if found is None:
        expected = f"a map that they follow; is it {meaning}, as {side_file(network.file).name} says?"
        raise InputError(network.file, f"a map that {len(output)} sparse points don't follow", expected)
    # The fit was made in the scene's own unit: disparity / unit, which is depth * unit.
    factor = unit if meaning == "disparity" else 1 / unit
    return AlignedOnnx(network, replace(found, scale=found.scale * factor, shift=found.shift * factor), unit)


def _at_points(
    training_set: TrainingSet, predict: Callable[[Tensor, str], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(outputs, disparities) of the sparse points of all views. predict: from a network's input and a view's name."""
    if training_set.points is None:
        raise InputError("option depth_prior", "network for a training set without points", "sparse points")
    outputs, disparities = [], []
    for index, view in enumerate(training_set.views):
        samples = sparse_depth(training_set.points, view.camera, index)
        at = np.stack([samples.columns.numpy() + 0.5, samples.rows.numpy() + 0.5], axis=1)
        output = predict(network_input(view.image), view.name)
        outputs.append(sampled(output, at, view.camera.width, view.camera.height))
        disparities.append(1 / samples.depth.numpy().astype(np.float64))
    return np.concatenate(outputs), np.concatenate(disparities)


def _scene_scale(network: nn.Module, training_set: TrainingSet) -> tuple[float, float, float]:
    """(unit, scale, shift) from the network's disparity to the scene's, by a robust fit to the sparse points of all
    views; if they don't correlate, by mean and spread alone."""

    def predict(image: Tensor, name: str) -> np.ndarray:
        with fixed_threads(), torch.no_grad():
            normalised = (image[None] - torch.tensor(MEAN).view(1, 3, 1, 1)) / torch.tensor(STD).view(1, 3, 1, 1)
            return network(normalised)[0, 0].numpy()

    output, disparity = _at_points(training_set, predict)
    unit = float(np.median(disparity))
    found = fit(output, disparity / unit, np.ones(len(output)), "disparity", "scale-shift")
    if found is not None:
        return unit, found.scale, found.shift
    scale = float(np.std(disparity / unit)) / max(float(np.std(output)), 1e-9)
    return unit, scale, 1.0 - scale * float(np.median(output))


def scale_invariant_loss(predicted: Tensor, target: Tensor, weight: Tensor, form: str) -> Tensor:
    """Eq. 8 over a batch of log depths (B, 1, H, W), weighted, with the best scale of each view.

    "squared" is the printed form, mean (log D^ + s - log D)^2, minimised by s = the mean of log D - log D^. "absolute"
    is the released form, the mean absolute difference after the same shift.
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
    progress: Update = silent,
) -> None:
    """Tune the network in place to the views' known depth and the sparse points.

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
    """Log depth and weight, (1, h, w) each, at the network's size. Of several depths in one pixel the last is taken,
    since a mean across an outline is on no surface."""
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
