"""Train depthnet on rendered rooms and export it.

    python datasets/depthnet/train.py --rooms WORK/rooms --work WORK --minutes 35 --out datasets/depthnet/depthnet.onnx

The learning rate depends on the processor time used so far, so a run that was killed continues from WORK/state.pt
without a difference. Rooms that are added to the folder in the meantime are used too.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro
from torch import Tensor

from dofbench.core.files import replacing
from dofbench.scenes.depth.depthnet import MEAN, STD, DepthNet

SIZES = ((128, 96), (192, 160))  # (width, height) of training images: small ones first, which are three times as fast
SWITCH = 0.75  # share of the budget at which the size changes
BATCH, RATE, DECAY = 16, 2e-3, 2e-2
AVERAGE = 0.998  # decay of the moving average of the weights, per step
GRADIENT, SCALES = 0.5, 4  # weight and number of scales of the gradient term
SAVE_SECONDS = 60.0
BACKGROUND = 0.0  # disparity where there is no surface: infinitely far


@dataclass(frozen=True)
class Settings:
    """What to train on, for how long, and where the network goes."""

    rooms: Path
    """Folder of rooms, as render.py writes them."""
    work: Path
    """Folder for the state of the training."""
    out: Path
    """The network to write."""
    minutes: float = 35.0
    """Processor time to train for."""
    seed: int = 0
    """Seed of initial weights, order and augmentation."""


def main(settings: Settings) -> None:
    """Train for the given time, then export the averaged weights."""
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    # Channels last: a fifth faster on a CPU.
    net = DepthNet().to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch forgot to declare it
    average = DepthNet()
    average.load_state_dict(net.state_dict())
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    state, used, step = settings.work / "state.pt", 0.0, 0
    if state.is_file():
        kept = torch.load(state, weights_only=True)
        net.load_state_dict(kept["net"])
        average.load_state_dict(kept["average"])
        optimiser.load_state_dict(kept["optimiser"])
        used, step = kept["used"], kept["step"]
        rng = np.random.default_rng([settings.seed, step])
    rooms = Rooms(settings.rooms)
    before, saved, losses = time.process_time() - used, time.perf_counter(), list[float]()
    while (used := time.process_time() - before) < 60 * settings.minutes:
        share = used / (60 * settings.minutes)
        for group in optimiser.param_groups:
            group["lr"] = RATE * min(1.0, (step + 1) / 100) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
        images, disparity = rooms.batch(rng, BATCH, *SIZES[share >= SWITCH])
        net.train()
        loss = relative_loss(net(images), disparity)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        step += 1
        losses.append(float(loss.detach()))
        _follow(average, net, min(AVERAGE, step / (step + 10)))
        if step % 50 == 0:
            print(f"step {step}: loss {np.mean(losses):.4f}, {len(rooms)} views, {used:.0f} s", flush=True)
            losses.clear()
            rooms.look_again()
        if time.perf_counter() - saved > SAVE_SECONDS:
            _save(state, net, average, optimiser, time.process_time() - before, step)
            saved = time.perf_counter()
    _save(state, net, average, optimiser, used, step)
    export(average.eval(), settings.out)
    print(f"{settings.out}: {sum(p.numel() for p in net.parameters())} parameters, {step} steps", flush=True)


class Rooms:
    """The views of all rooms in a folder, in memory: images uint8, disparity float16."""

    def __init__(self, folder: Path):
        self._folder, self._seen = folder, set[str]()
        self._images: list[np.ndarray] = []
        self._disparity: list[np.ndarray] = []
        self.look_again()

    def __len__(self) -> int:
        return len(self._images)

    def look_again(self) -> None:
        """Read rooms that have been added to the folder."""
        for file in sorted(self._folder.glob("[0-9]*.npz")):
            if file.name in self._seen:
                continue
            self._seen.add(file.name)
            with np.load(file) as room:
                images, depth = room["images"], room["depth"].astype(np.float32)
            disparity = np.where(depth > 0, 1 / np.maximum(depth, 1e-3), BACKGROUND)
            for image, one in zip(images, disparity, strict=True):
                # Views of constant depth, such as a wall that fills the picture, are left out
                if one.std() > 1e-3 * one.mean() > 0:
                    self._images.append(image)
                    self._disparity.append(one.astype(np.float16))

    def batch(self, rng: np.random.Generator, count: int, width: int, height: int) -> tuple[Tensor, Tensor]:
        """(count, 3, height, width) normalised images and (count, 1, height, width) disparities, augmented."""
        pictures, targets = [], []
        for index in rng.integers(0, len(self), count):
            picture, target = _cropped(rng, self._images[index], self._disparity[index], width, height)
            pictures.append((_recoloured(rng, picture) - MEAN) / STD)
            targets.append(target)
        images = np.stack(pictures).transpose(0, 3, 1, 2).astype(np.float32)
        fed = torch.from_numpy(images).contiguous(memory_format=torch.channels_last)
        return fed, torch.from_numpy(np.stack(targets)[:, None])


def relative_loss(predicted: Tensor, disparity: Tensor) -> Tensor:
    """Scale- and shift-invariant loss: both disparities are normalised to median 0 and mean absolute deviation 1; then
    they and their gradients at four scales are compared (Ranftl et al., Towards Robust Monocular Depth Estimation,
    section 5)."""
    difference = _standard(predicted) - _standard(disparity)
    loss = difference.abs().mean()
    for scale in range(SCALES):
        part = difference[..., :: 2**scale, :: 2**scale]
        loss = loss + GRADIENT * (part.diff(dim=2).abs().mean() + part.diff(dim=3).abs().mean())
    return loss


def export(net: torch.nn.Module, file: Path) -> None:
    """Write the network as ONNX with weights of half precision, which onnxruntime casts once on loading."""
    import onnx

    with replacing(file) as temporary:
        torch.onnx.export(
            net,
            (torch.zeros(1, 3, 192, 256),),
            str(temporary),
            input_names=["image"],
            output_names=["disparity"],
            dynamic_axes={"image": {2: "height", 3: "width"}, "disparity": {2: "height", 3: "width"}},
            opset_version=17,
            dynamo=False,
        )
        model = onnx.load(str(temporary))
        casts = []
        for weight in model.graph.initializer:
            values = onnx.numpy_helper.to_array(weight)
            if values.dtype == np.float32 and values.size > 1000:
                name = weight.name
                weight.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), f"{name}_half"))
                casts.append(onnx.helper.make_node("Cast", [f"{name}_half"], [name], to=onnx.TensorProto.FLOAT))
        nodes = [*casts, *model.graph.node]
        del model.graph.node[:]
        model.graph.node.extend(nodes)
        onnx.checker.check_model(model)
        onnx.save(model, str(temporary))


def _standard(x: Tensor) -> Tensor:
    flat = x.flatten(1)
    centred = flat - flat.median(dim=1, keepdim=True).values
    return (centred / centred.abs().mean(dim=1, keepdim=True).clamp_min(1e-6)).view_as(x)


def _cropped(
    rng: np.random.Generator, image: np.ndarray, disparity: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """A random crop of at least half of each side, perhaps mirrored, and resized: it looks like a view with another
    focal length."""
    rows, columns = image.shape[:2]
    share = rng.uniform(0.5, 1.0) if rng.random() < 0.8 else 1.0
    h, w = int(rows * share * rng.uniform(0.85, 1)), int(columns * share * rng.uniform(0.85, 1))
    top, left = rng.integers(0, rows - h + 1), rng.integers(0, columns - w + 1)
    picture = cv2.resize(image[top : top + h, left : left + w], (width, height), interpolation=cv2.INTER_AREA)
    part = disparity[top : top + h, left : left + w].astype(np.float32)
    target = cv2.resize(part, (width, height), interpolation=cv2.INTER_NEAREST)
    if rng.random() < 0.5:
        picture, target = picture[:, ::-1], target[:, ::-1]
    return picture.astype(np.float32) / 255, np.ascontiguousarray(target)


def _recoloured(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Change light and colours and add some noise and blur, so that the network learns from shading and size, not from
    colour."""
    image = image ** np.exp(rng.normal(0, 0.25)) * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.1, 3))
    if rng.random() < 0.3:
        image = image[..., rng.permutation(3)]
    if rng.random() < 0.3:
        grey = image.mean(2, keepdims=True)
        image = grey + (image - grey) * rng.uniform(0, 1)
    if rng.random() < 0.3:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.2))
    image = image + rng.normal(0, rng.uniform(0, 0.03), image.shape)
    return np.clip(image, 0, 1)


def _follow(average: DepthNet, net: DepthNet, share: float) -> None:
    with torch.no_grad():
        for kept, new in zip(average.state_dict().values(), net.state_dict().values(), strict=True):
            if kept.dtype.is_floating_point:
                kept.lerp_(new, 1 - share)
            else:
                kept.copy_(new)


def _save(
    file: Path, net: DepthNet, average: DepthNet, optimiser: torch.optim.Optimizer, used: float, step: int
) -> None:
    with replacing(file) as temporary:
        torch.save(
            {
                "net": net.state_dict(),
                "average": average.state_dict(),
                "optimiser": optimiser.state_dict(),
                "used": used,
                "step": step,
            },
            temporary,
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
