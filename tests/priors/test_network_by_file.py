"""A network by file as the prior, from the option to the depth of every pixel, on two small photographs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from onnx_networks import write_network
from tolerances import ALIGNED_DEPTH, FLOAT32_GRADIENT

from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.scenes.depth.network import find_network
from dofbench.training.common.options import content_digests
from dofbench.training.common.priors import make_prior
from dofbench.training.common.priors.network import open_network
from dofbench.training.gaussians.gaussian_options import GaussianOptions

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")


class Rows(torch.nn.Module):
    """Log depth 0 in the upper half and 1 in the lower one, whatever it is shown."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        rows = torch.arange(image.shape[2]).view(1, 1, -1, 1)
        return (rows >= image.shape[2] // 2).to(image.dtype) + 0 * image[:, :1]


def test_every_pixel_has_the_networks_depth_at_the_scale_of_the_points(tmp_path: Path) -> None:
    """Points at 4 in the upper half of both views, where the network says 1: all of it counts four times."""
    file = tmp_path / "rows.pt"
    torch.jit.script(Rows()).save(str(file))
    xyz = [((8.5 + 4 * place - 32) / 60 * 4, (10.5 - 32) / 60 * 4, 4.0) for place in range(5)]
    points = cloud(xyz, views=[np.array([0, 1])] * 5)
    image = np.full((64, 64, 3), 0.5, np.float32)
    views = tuple(TrainingView(name, frontal(64, 64, 60.0), image) for name in "ab")
    options = GaussianOptions.of(depth_prior="network", depth_prior_file=f"torchscript:{file}").prior
    prior = make_prior(TrainingSet(views, points), options, seed=0, steps=1)
    for index, view in enumerate(views):
        samples = prior.samples(index, view.camera)
        assert len(samples.depth) == 64 * 64
        depth = samples.depth.numpy().reshape(64, 64)
        assert np.allclose(depth[:30], 4.0, rtol=FLOAT32_GRADIENT)
        assert np.allclose(depth[34:], 4.0 * np.e, rtol=FLOAT32_GRADIENT)


def _training_set() -> TrainingSet:
    """Two views, lighter to the right, of points on a plane that is nearer to the right."""
    columns = np.arange(6.5, 58, 6)  # centres of pixels
    depth = 1 / (0.1 + 0.004 * columns)
    xyz = [((column - 32) / 60 * z, (row - 32) / 60 * z, z) for column, z in zip(columns, depth, strict=True)
           for row in (12.5, 30.5, 50.5)]  # fmt: skip
    image = np.broadcast_to(((np.arange(64) + 0.5) / 64)[:, None], (64, 64, 3)).astype(np.float32)
    views = tuple(TrainingView(name, frontal(64, 64, 60.0), image) for name in "ab")
    return TrainingSet(views, cloud(xyz, views=[np.array([0, 1])] * len(xyz)))


@pytest.mark.parametrize(("output", "function"), [("disparity", lambda x: x), ("depth", lambda x: 3 / (25 + 64 * x))])
def test_an_onnx_network_is_aligned_to_the_points(tmp_path: Path, output: str, function: Callable) -> None:
    """The light is the network's map, affine in disparity, or depth in another unit."""
    side = f'longest = 64\noutput = "{output}"\nalign = "{"scale-shift" if output == "disparity" else "scale"}"\n'
    file = write_network(tmp_path / "net.onnx", lambda image: function(image.mean(dim=1, keepdim=True)), side=side)
    options = GaussianOptions.of(depth_prior="network", depth_prior_file=str(file)).prior
    training_set = _training_set()
    prior = make_prior(training_set, options, seed=0, steps=1)
    depth = prior.samples(0, training_set.views[0].camera).depth.numpy().reshape(64, 64)
    expected = 1 / (0.1 + 0.004 * (np.arange(64) + 0.5))
    assert np.allclose(depth[:, 3:-3], np.broadcast_to(expected, (64, 64))[:, 3:-3], rtol=ALIGNED_DEPTH)


def test_a_network_that_the_points_contradict_is_named(tmp_path: Path) -> None:
    side = 'longest = 64\noutput = "disparity"\n'
    file = write_network(tmp_path / "net.onnx", lambda image: -image.mean(dim=1, keepdim=True), side=side)
    options = GaussianOptions.of(depth_prior="network", depth_prior_file=str(file)).prior
    with pytest.raises(InputError, match=r"net\.onnx: found a map that 54 sparse points don't follow"):
        make_prior(_training_set(), options, seed=0, steps=1)


@pytest.mark.parametrize("name", ["rows.pt", "rows.onnx"])
def test_code_of_a_torchscript_file_runs_only_where_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    torch.jit.script(Rows()).save(str(tmp_path / name))
    monkeypatch.setattr(torch.jit, "load", lambda *_, **__: pytest.fail("its code would have run"))
    options = GaussianOptions.of(depth_prior="network", depth_prior_file=str(tmp_path / name)).prior
    with pytest.raises(InputError, match=name):
        make_prior(_training_set(), options, seed=0, steps=1)


def test_the_shipped_networks_layers_in_another_file_can_be_tuned(tmp_path: Path) -> None:
    file = shutil.copyfile(find_network("depthnet"), tmp_path / "mine.onnx")
    network = open_network(str(file), _training_set())
    assert any(parameter.requires_grad for parameter in network.parameters())


def test_a_key_holds_the_content_of_what_an_option_names(tmp_path: Path) -> None:
    def digests(**options: str) -> dict[str, str]:
        return content_digests(GaussianOptions.of(**options))

    assert digests() == {}
    one, two = tmp_path / "one.onnx", tmp_path / "two.onnx"
    one.write_bytes(b"a")
    shutil.copyfile(one, two)
    first = digests(depth_prior="network", depth_prior_file=str(one))
    assert first.keys() == {"depth_prior_file"}
    assert digests(depth_prior="network", depth_prior_file=str(two)) == first
    assert digests(depth_prior="network", depth_prior_file=f"torchscript:{two}") == first
    two.write_bytes(b"b")
    assert digests(depth_prior="network", depth_prior_file=str(two)) != first
    (tmp_path / "one.onnx.toml").write_text("x")
    assert digests(depth_prior="network", depth_prior_file=str(one)) != first
    workspace = tmp_path / "dense"
    (workspace / "stereo").mkdir(parents=True)
    (workspace / "stereo" / "a.bin").write_bytes(b"a")
    before = digests(depth_prior="colmap", depth_prior_workspace=str(workspace))
    (workspace / "stereo" / "a.bin").write_bytes(b"b")
    assert digests(depth_prior="colmap", depth_prior_workspace=str(workspace)) != before
    with pytest.raises(InputError, match="option depth_prior_file"):
        digests(depth_prior="network", depth_prior_file=str(tmp_path / "none.onnx"))
