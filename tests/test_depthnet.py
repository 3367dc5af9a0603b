"""The shipped network: its file, its accuracy on the built-in scene, and its training code."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE, HALF_WEIGHTS

from dofbench.core.content import content_folder
from dofbench.datasets.synthesis.depth_sources import open_source
from dofbench.scenes import load_scene
from dofbench.scenes.depth.network import Network, find_network
from dofbench.scenes.scene import Scene

FOLDER = content_folder("datasets") / "depthnet"
LARGEST = 3_000_000  # bytes


@pytest.fixture(scope="module")
def train() -> Iterator[ModuleType]:
    """The training script, which is no part of the package."""
    sys.path.insert(0, str(FOLDER))
    try:
        yield import_module("train")
    finally:
        sys.path.remove(str(FOLDER))
        sys.modules.pop("train", None)


@pytest.fixture(scope="module")
def table_top() -> Scene:
    return load_scene(content_folder("datasets") / "tabletop")


def test_it_is_shipped_and_small() -> None:
    assert find_network("depthnet") == FOLDER / "depthnet.onnx"
    assert (FOLDER / "depthnet.onnx").stat().st_size < LARGEST


def test_any_shape_of_image_goes_in() -> None:
    network = Network(find_network("depthnet"))
    for size, expected in (((480, 640), (128, 160)), ((640, 480), (160, 128)), ((100, 100), (160, 160))):
        assert network.predict(np.full((*size, 3), 0.5, np.float32), "v").shape == expected


def test_on_the_built_in_scene_it_beats_a_constant(table_top: Scene, tmp_path: Path) -> None:
    """It was trained on table tops of other seeds too, so this is no more than its README claims."""
    source = open_source("onnx", table_top, steps=1, seed=0, work=tmp_path, network=find_network("depthnet"))
    network, constant = [], []
    for view in table_top.views[::6]:
        assert view.depth is not None
        disparity = 1 / view.depth()
        network.append(np.abs(1 / source.estimate(view).depth - disparity).mean())
        constant.append(np.abs(np.median(disparity) - disparity).mean())
    assert np.mean(network) < 0.5 * np.mean(constant)


@given(st.floats(0.01, 100), st.floats(-10, 10), st.integers(0, 99))
def test_the_loss_is_blind_to_scale_and_shift(train: ModuleType, scale: float, shift: float, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    one, other = (torch.rand(2, 1, 16, 24, generator=generator) for _ in range(2))
    loss = train.relative_loss(one, other)
    # Adding a shift rounds away as many digits as it is larger than what it is added to.
    rounding = FLOAT32_GRADIENT * (1 + abs(shift) / scale)
    assert torch.isclose(train.relative_loss(scale * one + shift, other), loss, rtol=rounding)
    assert train.relative_loss(scale * other + shift, other) < rounding < loss


def test_rooms_are_read_as_they_come(train: ModuleType, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def write(number: int, depth: np.ndarray) -> None:
        images = rng.integers(0, 255, (2, 192, 256, 3), dtype=np.uint8)
        np.savez(tmp_path / f"{number:07d}.npz", images=images, depth=depth.astype(np.float16))

    ramp = np.tile(np.linspace(1, 5, 256), (2, 192, 1))
    ramp[1] = 3.0  # a wall that fills the picture
    write(1, ramp)
    rooms = train.Rooms(tmp_path)
    assert len(rooms) == 1
    write(2, np.where(ramp > 4, 0, ramp))
    rooms.look_again()
    assert len(rooms) == 2
    images, disparity = rooms.batch(rng, 5, 64, 32)
    assert images.shape == (5, 3, 32, 64) and disparity.shape == (5, 1, 32, 64)
    assert images.dtype == disparity.dtype == torch.float32
    assert 0 <= float(disparity.min()) and float(disparity.max()) <= 1 + FLOAT32_VALUE


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the exporter, which is used on purpose
def test_what_is_exported_is_the_network(train: ModuleType, tmp_path: Path) -> None:
    torch.manual_seed(0)
    net = train.DepthNet().eval()
    train.export(net, tmp_path / "n.onnx")
    (tmp_path / "n.onnx.toml").write_text((FOLDER / "depthnet.onnx.toml").read_text())
    network = Network(tmp_path / "n.onnx")
    image = np.random.default_rng(0).uniform(0, 1, (128, 160, 3)).astype(np.float32)
    fed = torch.from_numpy(((image - train.MEAN) / train.STD).transpose(2, 0, 1)[None].astype(np.float32))
    with torch.no_grad():
        expected = net(fed)[0, 0].numpy()
    assert np.abs(network.predict(image, "v") - expected).max() < HALF_WEIGHTS * np.abs(expected).max()
