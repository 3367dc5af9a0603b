"""Networks as priors: the shipped one and one by file, as they are and tuned to the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import BEST_SCALE, FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.scenes.depth.align import Alignment
from dofbench.scenes.depth.depthnet import MEAN, STD, load_folded
from dofbench.scenes.depth.network import Network, find_network
from dofbench.training.common.depth import DepthMap
from dofbench.training.common.priors import network as networks
from dofbench.training.common.priors.network import open_network, predicted_depth, scale_invariant_loss, tune
from dofbench.training.common.priors.stereo import stereo_depth

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
