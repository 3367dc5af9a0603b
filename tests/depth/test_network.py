"""Feeding a network as its side file says, and errors in one line for invalid networks and side files."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from onnx_networks import mean_of_channels, write_network
from tolerances import FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.scenes.depth.network import PRESETS, Network, find_network, read_description, sampled, side_file

IMAGE = np.random.default_rng(0).uniform(0, 1, (48, 64, 3)).astype(np.float32)


def test_size_normalisation_and_order_of_colours(tmp_path):
    side = (
        'size = [32, 24]\nmean = [0.1, 0.2, 0.3]\nstd = [0.5, 0.25, 2.0]\nfull_scale = 255\ncolour = "bgr"\n'
        'output = "disparity"\n'
    )
    network = Network(write_network(tmp_path / "n.onnx", lambda image: image[:, 2:], side=side))
    small = IMAGE.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3))
    expected = (255 * small[..., 0] - 0.3) / 2.0  # the last channel of BGR is red
    np.testing.assert_allclose(network.predict(IMAGE, "v"), expected, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)


@pytest.mark.parametrize(
    ("preset", "size", "expected"),
    [
        ("midas", (640, 480), (384, 288)),
        ("midas", (480, 641), (288, 384)),
        ("depth-anything-v2", (640, 480), (686, 518)),
        ("depth-anything-v2", (480, 640), (518, 686)),
        ("depth-pro", (640, 480), (1536, 1536)),
    ],
)
def test_presets_ask_for_their_networks_sizes(tmp_path, preset, size, expected):
    (tmp_path / "n.onnx.toml").write_text(f'preset = "{preset}"\n')
    assert read_description(tmp_path / "n.onnx").input_size(*size) == expected


def test_presets_give_way_and_fixed_sizes_win(tmp_path):
    (tmp_path / "n.onnx.toml").write_text('preset = "depth-pro"\nlongest = 100\noutput = "depth"\n')
    description = read_description(tmp_path / "n.onnx")
    assert (description.output, description.size, description.longest) == ("depth", None, 100)
    assert description.mean == PRESETS["depth-pro"]["mean"]
    network = Network(write_network(tmp_path / "n.onnx", fixed=(40, 32), side='preset = "midas"\n'))
    assert network.predict(IMAGE, "v").shape == (32, 40)


def test_half_precision_goes_in(tmp_path):
    import onnx

    path = write_network(tmp_path / "n.onnx", fixed=(32, 32))
    model = onnx.load(path)
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.elem_type = onnx.TensorProto.FLOAT16
    onnx.save(model, path)
    assert Network(path).predict(IMAGE, "v").dtype == np.float32


def test_the_named_one_of_several_maps(tmp_path):
    def two(image):
        return mean_of_channels(image), 2 * mean_of_channels(image)

    path = write_network(tmp_path / "n.onnx", two, outputs=("one", "two"))
    with pytest.raises(InputError, match="tensor = "):
        Network(path).predict(IMAGE, "v")
    side_file(path).write_text('longest = 64\noutput = "depth"\ntensor = "two"\n')
    np.testing.assert_allclose(Network(path).predict(IMAGE, "v"), 2 * IMAGE.mean(axis=2), rtol=FLOAT32_VALUE)


def test_a_number_beside_the_map_is_passed_over(tmp_path):
    def with_angle(image):
        return mean_of_channels(image), image.mean()

    path = write_network(tmp_path / "n.onnx", with_angle, outputs=("map", "fov"), fixed=(64, 48))
    assert Network(path).predict(IMAGE, "v").shape == (48, 64)


def one_line(error, *words):
    assert "\n" not in str(error) and all(word in str(error) for word in words), str(error)


@pytest.mark.parametrize(
    ("side", "word"),
    [
        (None, "no such file"),
        ("longest = ", "no TOML"),
        ("longest = 64\n", "output"),
        ('output = "disparity"\n', "exactly one of size"),
        ('longest = 64\nsize = [8, 8]\noutput = "depth"\n', "exactly one of size"),
        ('longest = 64\noutput = "near"\n', "output"),
        ('preset = "zoe"\n', "preset"),
        ('longest = 64\noutput = "depth"\nstd = [1, 0, 1]\n', "std"),
        ('longest = 64\noutput = "depth"\nmeen = 1\n', "meen"),
        ('longest = 64\noutput = "depth"\nmean = [0.5]\n', "mean"),
        ('longest = 64\noutput = "depth"\ntensor = "depth"\n', "tensor"),
    ],
)
def test_a_side_file_that_is_wrong(tmp_path, side, word):
    path = write_network(tmp_path / "n.onnx", side=side)
    with pytest.raises(InputError) as caught:
        Network(path)
    one_line(caught.value, "n.onnx.toml", word)


def test_refused_images(tmp_path):
    path = write_network(tmp_path / "n.onnx", fixed=(32, 32), side='size = [64, 32]\noutput = "depth"\n')
    with pytest.raises(InputError) as caught:
        Network(path).predict(IMAGE, "v")
    one_line(caught.value, "n.onnx.toml", "64", "32")
    path = write_network(tmp_path / "n.onnx", lambda image: image[:, :1] + torch.zeros(1, 1, 32, 32))
    with pytest.raises(InputError) as caught:
        Network(path).predict(IMAGE, "v7")
    one_line(caught.value, "n.onnx", "view v7", "64x48")


@pytest.mark.parametrize("content", [b"", b"no network", None])
def test_a_file_that_is_no_network(tmp_path, content):
    path = write_network(tmp_path / "n.onnx")
    path.write_bytes(path.read_bytes()[:-40] if content is None else content)
    with pytest.raises(InputError) as caught:
        Network(path)
    one_line(caught.value, "n.onnx", "no readable network")


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda image: image.mean(dim=(2, 3)), ("outputs map (1, 3)", "view v7")),
        (lambda image: image, ("(1, 3, 48, 64)", "view v7")),
        (lambda image: image[:, :1] / 0.0, ("not finite", "view v7")),
        (lambda image: torch.sqrt(image[:, :1] - 2), ("3072 values", "view v7")),
    ],
)
def test_an_output_that_is_no_map(tmp_path, function, words):
    path = write_network(tmp_path / "n.onnx", function, fixed=(64, 48))
    with pytest.raises(InputError) as caught:
        Network(path).predict(IMAGE + 0.1, "v7")
    one_line(caught.value, "n.onnx", *words)


def test_samples_and_names(tmp_path):
    path = write_network(tmp_path / "n.onnx")
    assert find_network(str(path)) == path
    with pytest.raises(InputError, match="no such file"):
        find_network("nonesuch")
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    xy = np.array([[0.5, 0.5], [3.5, 2.5], [1.0, 0.5], [0.0, 0.0]])
    np.testing.assert_allclose(sampled(values, xy, 4, 3), [0, 11, 0.5, 0], atol=FLOAT32_VALUE)
    np.testing.assert_allclose(sampled(values, 2 * xy, 8, 6), [0, 11, 0.5, 0], atol=FLOAT32_VALUE)
