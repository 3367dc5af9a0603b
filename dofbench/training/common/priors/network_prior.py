"""Depth by a monocular network: the shipped network or one from a file, used as it is or tuned (`tuning.py`).

A network from a file is ONNX, with the side file that `scenes.depth.network` describes: no code of the file's runs. A
file with the weights of the shipped network's layers can be tuned, as the shipped one; any other is used as it is.

A TorchScript file holds code that runs with the user's rights. It is loaded only where the option says so, as
torchscript:FILE. Input (B, 3, H, W) float32 RGB in [0, 1], H and W multiples of 32; output (B, 1, H, W), the logarithm
of z-depth up to one constant a view. To be tuned, its parameters must require gradients. The network runs in evaluation
mode: statistics of batch normalisation don't change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from dofbench.scenes.depth.align import UNALIGNED, Alignment, fit
from dofbench.scenes.depth.depthnet import MEAN, MULTIPLE, STD, load_folded
from dofbench.scenes.depth.network import Network, find_network, sampled, side_file
from dofbench.training.common.content_options import TORCHSCRIPT
from dofbench.training.common.priors.prior_progress import Progress, silent
from dofbench.training.common.supervision import DepthMap, sparse_depth

SHIPPED = "depthnet"
LONGEST = 256  # px, longer side of the network's input
THREADS = 1  # torch's threads: the bits of a convolution's gradient depend on their number
_FLOOR = 1e-3  # least disparity, as a share of the scene's median


class LogDepth(nn.Module):
    """Turns a network of relative disparity into one of log depth: -log of the positive part of scale * output + shift.

    unit: the disparity, 1 / scene unit, that an output of 1 stands for. scale and shift are tuned like the other
    parameters.
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
        # A smooth positive part: practically the disparity itself above a tenth of the unit, and positive below.
        return -torch.log((functional.softplus(disparity, beta=20) + _FLOOR) * self.unit)


class AlignedOnnx(nn.Module):
    """Turns any ONNX network into one of log depth, by one alignment for the whole scene. Nothing of it can be tuned.

    unit: the median disparity of the scene's points, 1 / scene unit; disparity is cut at `_FLOOR` of it, and at the
    inverse share above.
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
    """A network of log depth, scaled to the scene's disparities: an ONNX file, or for "" the shipped network. With
    `TORCHSCRIPT` before its name, a TorchScript file, whose code runs.

    Raises InputError for a file that isn't such a network.
    """
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
    """(width, height) that a photograph is resized to: at most LONGEST, and multiples of the network's stride."""
    share = min(1.0, LONGEST / max(width, height))
    across, down = (max(MULTIPLE, round(side * share / MULTIPLE) * MULTIPLE) for side in (width, height))
    return across, down


def network_input(image: np.ndarray) -> Tensor:
    """The network's input (3, h, w) from a photograph (H, W, 3)."""
    width, height = input_size(image.shape[1], image.shape[0])
    small = np.clip(resize(image, width, height), 0, 1)
    return torch.from_numpy(np.ascontiguousarray(small.transpose(2, 0, 1), dtype=np.float32))


@contextmanager
def fixed_threads() -> Iterator[None]:
    """A block in which torch uses `THREADS` threads, so that the result is the same on every machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def predicted_depth(
    network: nn.Module, training_set: TrainingSet, known: Sequence[DepthMap] | None, *, progress: Progress = silent
) -> list[DepthMap]:
    """The network's depth map of every view, scaled by the median ratio of the view's known depth to the network's.

    known: semi-dense depth per view; None for the sparse points alone. A view without known depth keeps the network's
    scale. Raises FloatingPointError for depth that isn't finite.
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
        maps.append(DepthMap(depth.astype(np.float32), np.ones(size, np.float32)))
    progress("depth prior: network", len(maps), len(maps))
    return maps


def run(network: nn.Module, images: Tensor, name: str) -> Tensor:
    """The network's output (B, 1, H, W) for (B, 3, H, W). Raises InputError for an output of another shape."""
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
    if training_set.points is None:
        raise InputError("option depth_prior", "network for a training set without points", "sparse points")
    outputs, disparities = [], []
    for index, view in enumerate(training_set.views):
        samples = sparse_depth(training_set.points, view.camera, index)
        output = network.predict(network_input(view.image).permute(1, 2, 0).numpy(), view.name)
        at = np.stack([samples.columns.numpy() + 0.5, samples.rows.numpy() + 0.5], axis=1)
        outputs.append(sampled(output, at, view.camera.width, view.camera.height))
        disparities.append(1 / samples.depth.numpy().astype(np.float64))
    output, disparity = np.concatenate(outputs), np.concatenate(disparities)
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


def _scene_scale(network: nn.Module, training_set: TrainingSet) -> tuple[float, float, float]:
    """(unit, scale, shift) that turn the network's disparity into the scene's, from the sparse points of all views.

    A robust fit; if the network's output doesn't correlate with the points, their mean and spread alone.
    """
    if training_set.points is None:
        raise InputError("option depth_prior", "network for a training set without points", "sparse points")
    outputs, disparities = [], []
    for index, view in enumerate(training_set.views):
        samples = sparse_depth(training_set.points, view.camera, index)
        image = network_input(view.image)
        with fixed_threads(), torch.no_grad():
            normalised = (image[None] - torch.tensor(MEAN).view(1, 3, 1, 1)) / torch.tensor(STD).view(1, 3, 1, 1)
            output = network(normalised)[0, 0].numpy()
        at = np.stack([samples.columns.numpy() + 0.5, samples.rows.numpy() + 0.5], axis=1)
        outputs.append(sampled(output, at, view.camera.width, view.camera.height))
        disparities.append(1 / samples.depth.numpy().astype(np.float64))
    output, disparity = np.concatenate(outputs), np.concatenate(disparities)
    unit = float(np.median(disparity))
    found = fit(output, disparity / unit, np.ones(len(output)), "disparity", "scale-shift")
    if found is not None:
        return unit, found.scale, found.shift
    scale = float(np.std(disparity / unit)) / max(float(np.std(output)), 1e-9)
    return unit, scale, 1.0 - scale * float(np.median(output))
