"""Networks as priors: the shipped one and one by file, as they are and tuned to the scene."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import cloud, frontal
from onnx_networks import write_network
from tolerances import ALIGNED_DEPTH, BEST_SCALE, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.scenes.depth.align import Alignment
from dofbench.scenes.depth.depthnet import MEAN, STD, load_folded
from dofbench.scenes.depth.network import Network, find_network
from dofbench.training.common.depth_map import DepthMap
from dofbench.training.common.options import content_digests
from dofbench.training.common.priors import make_prior
from dofbench.training.common.priors import network as networks
from dofbench.training.common.priors import network as tuning
from dofbench.training.common.priors.network import open_network, predicted_depth, scale_invariant_loss, tune
from dofbench.training.common.priors.stereo import stereo_depth
from dofbench.training.gaussians.gaussian_options import GaussianOptions

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")


class Ramp(torch.nn.Module):
    """Log depth that grows from top to bottom: wrong everywhere, but trainable."""

    def __init__(self, channels: int = 1):
        super().__init__()
        self.colour = torch.nn.Conv2d(3, channels, 1)
        self.slope = torch.nn.Parameter(torch.tensor(1.0))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        rows = torch.linspace(0, 1, image.shape[2]).view(1, 1, -1, 1)
        return self.colour(image) + self.slope * rows


@pytest.fixture
def script(tmp_path):
    """Save a module as TorchScript; returns what the option must say."""

    def save(module: torch.nn.Module, name: str = "n.pt") -> str:
        torch.manual_seed(0)
        torch.jit.script(module).save(str(tmp_path / name))
        return f"torchscript:{tmp_path / name}"

    return save


@pytest.fixture(scope="module")
def known(photographed) -> list[DepthMap]:
    return stereo_depth(photographed.training_set)


def _error(maps, photographed) -> float:
    return float(
        np.mean([np.abs(np.log(one.depth / true)).mean() for one, true in zip(maps, photographed.truth, strict=True)])
    )


def test_the_folded_network_gives_what_the_shipped_file_gives():
    image = np.random.default_rng(0).uniform(0, 1, (128, 160, 3)).astype(np.float32)
    expected = Network(find_network("depthnet")).predict(image, "v")
    fed = torch.from_numpy(((image - MEAN) / STD).transpose(2, 0, 1)[None].astype(np.float32))
    found = load_folded(find_network("depthnet"))(fed)[0, 0]
    assert found.requires_grad
    assert np.abs(found.detach().numpy() - expected).max() < FLOAT32_VALUE * np.abs(expected).max()


@pytest.mark.parametrize("content", [b"", b"no network", b"\x3a\xff\x01", b"\x3a\x02\x08\x01"])
def test_what_is_no_network_of_that_kind_is_refused(tmp_path, content):
    file = tmp_path / "n.onnx"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"n\.onnx") as caught:
        load_folded(file)
    assert "\n" not in str(caught.value)


@given(st.sampled_from(["squared", "absolute"]), st.floats(-3, 3), st.integers(0, 99))
def test_the_loss_is_blind_to_each_views_scale(form, shift, seed):
    predicted, target, weight = torch.rand(3, 2, 1, 8, 9, generator=torch.Generator().manual_seed(seed))
    moved = predicted + torch.tensor([shift, -2 * shift]).view(2, 1, 1, 1)
    loss = scale_invariant_loss(predicted, target, weight, form)
    assert torch.isclose(scale_invariant_loss(moved, target, weight, form), loss, rtol=FLOAT32_GRADIENT)
    assert scale_invariant_loss(target + shift, target, weight, form) < FLOAT32_GRADIENT


def test_the_closed_form_scale_is_the_best_one():
    """Eq. 8 has s as a parameter: none gives less than the one that the loss takes."""
    predicted, target, weight = torch.rand(3, 1, 1, 8, 9, generator=torch.Generator().manual_seed(0)).double()
    by_hand = [float((weight * (predicted + s - target) ** 2).sum() / weight.sum()) for s in np.linspace(-1, 1, 2001)]
    found = float(scale_invariant_loss(predicted, target, weight, "squared"))
    assert found == pytest.approx(min(by_hand), abs=BEST_SCALE)


def test_the_loss_by_hand():
    predicted, target = torch.zeros(1, 1, 1, 3), torch.tensor([0.0, 3.0, 99.0]).view(1, 1, 1, 3)
    weight = torch.tensor([1.0, 1.0, 0.0]).view(1, 1, 1, 3)
    assert float(scale_invariant_loss(predicted, target, weight, "squared")) == pytest.approx(2.25)
    assert float(scale_invariant_loss(predicted, target, weight, "absolute")) == pytest.approx(1.5)
    assert float(scale_invariant_loss(predicted, target, 0 * weight, "squared")) == 0.0


def test_the_shipped_network_as_it_is_fits_the_scene_roughly(photographed):
    maps = predicted_depth(open_network("", photographed.training_set), photographed.training_set, None)
    constant = [DepthMap(np.full_like(true, np.median(true)), None) for true in photographed.truth]
    assert all((one.depth > 0).all() and (one.weight == 1).all() for one in maps)
    assert _error(maps, photographed) < 0.7 * _error(constant, photographed)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["squared", "absolute"])
def test_tuning_brings_it_nearer_to_the_truth(photographed, known, loss, monkeypatch):
    monkeypatch.setattr(networks, "LONGEST", 96)  # a sixth of the pixels, and of the time
    training_set = photographed.training_set
    network = open_network("", training_set)
    before = _error(predicted_depth(network, training_set, known), photographed)
    tune(network, training_set, known, steps=30, loss=loss, seed=0)
    assert _error(predicted_depth(network, training_set, known), photographed) < 0.9 * before


def test_tuning_repeats_bit_for_bit_on_any_number_of_threads(photographed, known, monkeypatch):
    monkeypatch.setattr(networks, "LONGEST", 96)
    found, threads = set(), torch.get_num_threads()
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            network = open_network("", photographed.training_set)
            tune(network, photographed.training_set, known, steps=3, loss="squared", seed=1)
            maps = predicted_depth(network, photographed.training_set, known)
            found.add(b"".join(one.depth.tobytes() for one in maps))
            assert torch.get_num_threads() == count
    finally:
        torch.set_num_threads(threads)
    assert len(found) == 1


def test_a_network_by_file_is_scaled_to_each_view_and_tuned(photographed, known, script):
    training_set = photographed.training_set
    network = open_network(script(Ramp()), training_set)
    maps = predicted_depth(network, training_set, known)
    for one, near in zip(maps, known, strict=True):
        there = near.depth > 0
        assert np.median(near.depth[there] / one.depth[there]) == pytest.approx(1, rel=FLOAT32_GRADIENT)
    before = _error(maps, photographed)
    tune(network, training_set, known, steps=150, loss="squared", seed=0)
    assert _error(predicted_depth(network, training_set, known), photographed) < before


def test_networks_that_break_the_contract_are_named(photographed, known, script, tmp_path):
    training_set = photographed.training_set
    (tmp_path / "text.pt").write_text("no network")
    with pytest.raises(InputError, match=r"text\.pt"):
        open_network(f"torchscript:{tmp_path / 'text.pt'}", training_set)
    with pytest.raises(InputError, match=r"\(B, 1, H, W\)"):
        predicted_depth(open_network(script(Ramp(2)), training_set), training_set, known)
    frozen = Ramp().requires_grad_(False)
    with pytest.raises(InputError, match="trainable"):
        tune(open_network(script(frozen), training_set), training_set, known, steps=1, loss="squared", seed=0)


def test_depth_that_is_not_finite_is_a_failure(photographed, known, script):
    training_set = photographed.training_set
    broken = Ramp()
    with torch.no_grad():
        broken.slope.fill_(torch.inf)
    network = open_network(script(broken), training_set)
    with pytest.raises(FloatingPointError, match="finite"):
        predicted_depth(network, training_set, known)
    with pytest.raises(FloatingPointError, match="tuning step 1"):
        tune(network, training_set, known, steps=5, loss="squared", seed=0)


def test_nothing_to_tune_by_is_named(photographed):
    empty = [DepthMap(np.zeros_like(true), np.zeros_like(true)) for true in photographed.truth]
    training_set = replace(photographed.training_set, points=None)
    network = open_network("", photographed.training_set)
    with pytest.raises(InputError, match="no depth"):
        tune(network, training_set, empty, steps=1, loss="squared", seed=0)


@pytest.mark.parametrize("found", [Alignment(3.0, -2.0, 1.0, 0.0), None])
def test_a_networks_output_becomes_disparity_by_the_fit_or_by_the_points_middle(
    photographed, found: Alignment | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    training_set, outputs = photographed.training_set, []

    def fit(output: np.ndarray, *_: object) -> Alignment | None:
        outputs.append(output)
        return found

    monkeypatch.setattr(networks, "fit", fit)
    unit, scale, shift = networks._scene_scale(Ramp(), training_set)
    depth = [
        networks.sparse_depth(training_set.points, view.camera, index).depth
        for index, view in enumerate(training_set.views)
    ]
    assert unit == pytest.approx(float(np.median(1 / torch.cat(depth).double().numpy())))
    if found is not None:
        assert (scale, shift) == (3.0, -2.0)
    else:
        assert scale > 0 and scale * np.median(outputs[0]) + shift == pytest.approx(1.0)


@pytest.mark.parametrize("form", ["squared", "absolute"])
def test_the_loss_is_a_mean_whatever_the_sum_of_the_weights(form: str) -> None:
    predicted, target, weight = torch.rand(3, 2, 1, 8, 9, generator=torch.Generator().manual_seed(1))
    loss = scale_invariant_loss(predicted, target, weight, form)
    faint = scale_invariant_loss(predicted, target, weight * 1e-3, form)
    assert torch.isclose(faint, loss, rtol=FLOAT32_GRADIENT)


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


class Number(torch.nn.Module):
    """One parameter."""

    def __init__(self) -> None:
        super().__init__()
        self.number = torch.nn.Parameter(torch.tensor(1.0, dtype=torch.float64))


def _photographs(count: int) -> tuple[TrainingSet, list[DepthMap]]:
    image = np.full((32, 32, 3), 0.5, np.float32)
    views = tuple(TrainingView(f"v{index}", frontal(32, 32, 30.0), image) for index in range(count))
    known = [DepthMap(np.full((32, 32), 2.0, np.float32), np.ones((32, 32), np.float32)) for _ in range(count)]
    return TrainingSet(views, None), known


def _tuned(monkeypatch: pytest.MonkeyPatch, count: int, steps: int) -> tuple[list[list[str]], list[float]]:
    """The photographs of each step, and the parameter before each and at the end, where the gradient is always 1."""
    network, batches, values = Number(), [], []

    def run(given: Number, images: torch.Tensor, names: str) -> torch.Tensor:
        batches.append(names.split(", "))
        values.append(float(given.number.detach()))
        assert len(images) == len(batches[-1])
        return images[:, :1]

    monkeypatch.setattr(tuning, "run", run)
    monkeypatch.setattr(tuning, "scale_invariant_loss", lambda *_: network.number)
    tuning.tune(network, *_photographs(count), steps=steps, loss="squared", seed=3)
    return batches, [*values, float(network.number.detach())]


def test_every_photograph_is_taken_once_a_round_five_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    batches, _ = _tuned(monkeypatch, 7, 14)
    assert [len(batch) for batch in batches] == [5] * 14
    drawn = [name for batch in batches for name in batch]
    rounds = [drawn[start : start + 7] for start in range(0, 70, 7)]
    assert all(sorted(names) == [f"v{index}" for index in range(7)] for names in rounds)
    assert len({tuple(names) for names in rounds}) > 5  # in an order of its own each


def test_few_photographs_are_all_taken_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    batches, _ = _tuned(monkeypatch, 3, 4)
    assert all(len(batch) >= 3 for batch in batches)


def test_the_rate_falls_to_a_tenth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a gradient that stays the same, Adam moves a parameter by exactly its rate: 4e-4, times 0.1 to the power
    of the share of the steps."""
    _, values = _tuned(monkeypatch, 2, 9)
    expected = [4e-4 * 0.1 ** (step / 10) for step in range(9)]
    assert -np.diff(values) == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_points_come_before_other_depth_in_their_pixels() -> None:
    """At the network's size, half as large here; log depth, and a weight of 1 for a point."""
    camera = frontal(32, 32, 16.0)
    depth, weight = np.zeros((32, 32), np.float32), np.zeros((32, 32), np.float32)
    depth[4:6, 8:10], weight[4:6, 8:10] = 3.0, 0.25
    depth[20, 21], weight[20, 21] = 5.0, 0.5
    # Of the pixel (row 4, column 8): its centre is at (8.5 - 16, 4.5 - 16) / 16 of the depth.
    points = cloud([((8.5 - 16) / 16 * 7, (4.5 - 16) / 16 * 7, 7.0)], views=[np.array([0])])
    view = TrainingView("v", camera, np.zeros((32, 32, 3), np.float32))
    log_depth, counted = tuning._target(TrainingSet((view,), points), 0, DepthMap(depth, weight), torch.Size((16, 16)))
    expected, share = np.zeros((1, 16, 16)), np.zeros((1, 16, 16))
    expected[0, 2, 4], share[0, 2, 4] = np.log(7), 1.0
    expected[0, 10, 10], share[0, 10, 10] = np.log(5), 0.5
    assert np.allclose(log_depth.numpy(), expected, rtol=FLOAT32_VALUE)
    assert np.allclose(counted.numpy(), share, rtol=FLOAT32_VALUE)
