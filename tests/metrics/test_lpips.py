"""LPIPS against its formula with torch's own layers, and weights that aren't those of LPIPS."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from lpips_weights import TAPS, VGG19, alexnet, backbone, linear, state, vgg, write_weights
from tolerances import FLOAT32_DISTORTION
from torch import nn

from dofbench.core.errors import InputError
from dofbench.evaluation.metrics.lpips import Lpips, load_lpips


def pair(height: int = 40, width: int = 52) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    truth = random.random((height, width, 3))
    return np.clip(truth + 0.1 * random.standard_normal(truth.shape), 0, 1), truth


def expected_distance(name: str, features: nn.Sequential, prediction: np.ndarray, truth: np.ndarray) -> float:
    """Equation 1 of the paper in float64: the mean over pixels of w · (y - y')², summed over the layers."""
    found = []
    for image in (prediction, truth):
        scaled = (image * 2 - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
        layer, outputs = torch.from_numpy(scaled.transpose(2, 0, 1))[None], []
        for index, module in enumerate(features.double()):
            layer = module(layer)
            if index in TAPS[name]:
                outputs.append(layer[0].detach().numpy())
        found.append(outputs)
    total = 0.0
    for one, other, weights in zip(*found, linear(name).values(), strict=True):
        one, other = (values / np.linalg.norm(values, axis=0) for values in (one, other))
        total += float(np.einsum("c,chw->hw", weights.flatten().double().numpy(), (one - other) ** 2).mean())
    return total


@pytest.fixture
def lpips(tmp_path: Path) -> Lpips:
    return load_lpips(write_weights(tmp_path))


@pytest.mark.parametrize("name", ["alex", "vgg"])
def test_it_is_the_papers_formula(tmp_path: Path, name: str) -> None:
    prediction, truth = pair()
    found = load_lpips(write_weights(tmp_path, name))
    assert found.id == f"lpips_{name}"
    expected = expected_distance(name, backbone(name), prediction, truth)
    assert found(prediction, truth) == pytest.approx(expected, rel=FLOAT32_DISTORTION)


def test_equal_images_and_the_order_of_two(lpips: Lpips) -> None:
    prediction, truth = pair()
    assert lpips(truth, truth.copy()) == 0
    assert lpips(prediction, truth) == pytest.approx(lpips(truth, prediction), rel=FLOAT32_DISTORTION)
    half = 0.5 * (prediction + truth)
    assert 0 < lpips(half, truth) < lpips(prediction, truth)
    assert math.isnan(lpips(np.where(np.arange(3) == 1, math.nan, truth), truth))


def test_what_a_mask_hides_has_no_influence(lpips: Lpips) -> None:
    prediction, truth = pair(64, 64)
    mask = np.ones((64, 64), dtype=bool)
    assert lpips(prediction, truth, mask) == pytest.approx(lpips(prediction, truth), rel=FLOAT32_DISTORTION)
    mask[:, 40:] = False
    spoilt = np.where(mask[..., None], prediction, 1 - prediction)
    assert lpips(spoilt, truth, mask) == lpips(prediction, truth, mask) > 0
    assert lpips(spoilt, truth) > lpips(prediction, truth)


@pytest.mark.parametrize(("name", "smallest"), [("alex", 31), ("vgg", 16)])
def test_the_smallest_image(tmp_path: Path, name: str, smallest: int) -> None:
    lpips = load_lpips(write_weights(tmp_path, name))
    assert lpips.smallest == smallest and lpips(*pair(smallest, smallest)) > 0
    with pytest.raises(ValueError, match=f"at least {smallest} x {smallest} pixels"):
        lpips(*pair(smallest - 1, smallest))


def test_the_same_weights_in_other_files_have_the_same_sha256(tmp_path: Path, lpips: Lpips) -> None:
    """In one file, as the lpips package's own model is saved, and as older versions of torch wrote files."""
    slices = {"0": 1, "3": 2, "6": 3, "8": 4, "10": 5}
    own = backbone("alex").state_dict()
    both = {f"net.slice{slices[key.split('.')[0]]}.{key}": value for key, value in own.items()}
    both |= {"scaling_layer.shift": torch.zeros(1, 3, 1, 1), **linear("alex")}
    both |= {f"lins.{key[3:]}": value for key, value in linear("alex").items()}
    torch.save(both, tmp_path / "both.pth")
    torch.save(state(backbone("alex")), tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    for files in ([tmp_path / "both.pth"], [tmp_path / "alex-0.pth", tmp_path / "old.pth"]):
        again = load_lpips(files)
        assert again.sha256 == lpips.sha256
        assert again(*pair()) == lpips(*pair())
    assert load_lpips(write_weights(tmp_path, seed=1)).sha256 != lpips.sha256


def changed(key: str, change: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, torch.Tensor]:
    whole = {**state(alexnet()), **linear("alex")}
    return {**whole, key: change(whole[key])}


@pytest.mark.parametrize(
    ("contents", "match"),
    [
        (lambda: [], "nothing"),
        (lambda: [state(alexnet())], r"alex\.pth of the lpips package"),
        (lambda: [state(vgg())], r"vgg\.pth of the lpips package"),
        (lambda: [linear("alex")], "no backbone"),
        (lambda: [state(alexnet()), linear("vgg")], r"lin1 of shape \(1, 128, 1, 1\), expected shape \(1, 192, 1, 1\)"),
        (lambda: [state(vgg(VGG19)), linear("vgg")], r"no features\.17\.weight, .* VGG16"),
        (lambda: [state(alexnet()), linear("alex"), linear("alex")], r"lin0, as in 1\.pth"),
        (lambda: [changed("features.3.bias", lambda bias: bias[1:])], r"features\.3\.bias of shape \(191,\)"),
        (lambda: [changed("features.3.bias", lambda bias: bias * math.nan)], r"features\.3\.bias with values"),
        (lambda: [changed("lin2.model.1.weight", lambda weight: -weight)], "lin2 with values that are negative"),
        (lambda: [{"fc.weight": torch.zeros(3, 4)}], "neither convolutions nor linear layers"),
        (lambda: [[torch.zeros(3)]], "neither convolutions nor linear layers"),
        (lambda: [alexnet()], "no state dict"),
    ],
)
def test_other_weights_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, contents: Callable[[], list[object]], match: str
) -> None:
    monkeypatch.chdir(tmp_path)
    files = []
    for number, content in enumerate(contents()):
        files.append(Path(f"{number}.pth"))
        torch.save(content, files[-1])
    with pytest.raises(InputError, match=match):
        load_lpips(files)


class Trap:
    """Creates a file when it is unpickled."""

    def __init__(self, file: Path):
        self.file = file

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.file,)


def test_files_that_are_no_weights(tmp_path: Path) -> None:
    whole = write_weights(tmp_path)[0].read_bytes()
    trap = pickle.dumps({"features.0.weight": Trap(tmp_path / "sprung")})
    for content in (b"", b"weights", whole[: len(whole) // 2], trap):
        (tmp_path / "file.pth").write_bytes(content)
        with pytest.raises(InputError, match=r"file\.pth: found no state dict"):
            load_lpips([tmp_path / "file.pth"])
    assert not (tmp_path / "sprung").exists()
    with pytest.raises(InputError, match="no such file"):
        load_lpips([tmp_path / "none.pth"])
    with pytest.raises(InputError, match="a folder"):
        load_lpips([tmp_path])
