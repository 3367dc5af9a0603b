"""What make-dataset writes, against the definitions written out again here."""

from __future__ import annotations

import json
from datetime import datetime
from functools import partial

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from tolerances import FLOAT16_VALUE, FLOAT32_VALUE, FLOAT64_VALUE, LEVEL_8BIT, POSE_ROUND_TRIP, RECOMPUTED_PSNR

from dofbench.core.errors import InputError
from dofbench.core.images import read_exr, read_image, write_exr, write_png
from dofbench.core.lens import ApertureShape
from dofbench.core.progress import Silent, Terminal
from dofbench.datasets.synthesis import check_dataset, depth_sources, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.runtime.ops import load
from dofbench.scenes import load_scene
from dofbench.scenes.depth.source import DepthEstimate

pytestmark = pytest.mark.usefixtures("one_torch_thread")
near = partial(pytest.approx, rel=FLOAT64_VALUE)
VIEWS = [f"v{index:02d}" for index in range(6)]


@pytest.fixture
def make(scene, tmp_path):
    """`make(**options)`: a dataset of the tiny scene in a folder of its own."""

    def run(**options):
        out = tmp_path / f"out{len(list(tmp_path.iterdir()))}"
        return make_dataset(MakeDataset(**{"scene": str(scene), "out": out, **options}), progress=Silent())

    return run


def recomputed_psnr(folder, record, lenses):
    """PSNR of images/VIEW.png against the direct float64 scatter of what the dataset says."""
    sharp = read_image(folder / "all_in_focus" / f"{record['name']}.png").astype(np.float64)
    z = read_exr(folder / "depth" / f"{record['name']}.exr").astype(np.float64)
    q_min, q_max = lenses["disparity_range"]
    disparity = np.where(z > 0, 1 / np.where(z > 0, z, 1), 0)
    radius = record["k_px"] * ((disparity - q_min) / (q_max - q_min) - record["focus"])
    again = load("scatter", "reference")(
        torch.from_numpy(sharp ** lenses["gamma"]),
        torch.from_numpy(radius),
        alpha=lenses["alpha"],
        energy=lenses["energy"],
        shape=ApertureShape(**lenses["shape"]),
    ).numpy() ** (1 / lenses["gamma"])
    error = np.mean((again - read_image(folder / "images" / f"{record['name']}.png")) ** 2)
    return -10 * np.log10(error)


def lens_file(folder):
    return json.loads((folder / "lens.json").read_text())


def test_the_folder_is_as_the_conventions_say(dataset_folder, contents):
    expected = {"dataset.json", "lens.json", "poses_bounds.npy", "transforms.json", "contact_sheet.png", "README.md"}
    expected |= {f"sparse/0/{name}.bin" for name in ("cameras", "images", "points3D")}
    for name in VIEWS:
        expected |= {f"images/{name}.png", f"images_linear/{name}.exr", f"all_in_focus/{name}.png", f"depth/{name}.exr"}
        expected |= {f"confidence/{name}.png"}
    assert contents(dataset_folder).keys() == expected
    manifest = json.loads((dataset_folder / "dataset.json").read_text())
    assert manifest["files"].keys() == expected - {"dataset.json"}
    assert manifest["depth"]["source"] == "given"
    assert check_dataset(dataset_folder) == []


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"energy": "algorithm1"},
        {"normaliser": "view"},
        {"gamma": 2.0, "alpha": 2.0},
        {"shape": "5-gon", "shape_rotation": 20.0, "shape_curvature": 0.3},
        {"shape_obstruction": 0.4},
    ],
    ids=lambda options: " ".join(map(str, options.values())) or "defaults",
)
def test_every_view_can_be_recomputed(make, options):
    folder = make(aperture=(1.0,), **options)
    lenses = lens_file(folder)
    assert min(recomputed_psnr(folder, record, lenses) for record in lenses["views"]) >= RECOMPUTED_PSNR


def test_noise_has_the_variance_asked_for(make):
    clean, noisy = make(aperture=(1.0,)), make(aperture=(1.0,), photons=400.0, read_noise=0.01)
    assert check_dataset(noisy) == []
    standard = []
    for name in VIEWS:
        without, with_noise = (read_exr(folder / "images_linear" / f"{name}.exr") for folder in (clean, noisy))
        # Where nothing was cut off at 0.
        bright = without > 0.1
        standard.append(((with_noise - without) / np.sqrt(without / 400 + 1e-4))[bright])
        assert (with_noise >= 0).all()
    standard = np.concatenate(standard)
    # Three standard errors of the mean and the standard deviation.
    assert abs(standard.mean()) < 3 / standard.size**0.5
    assert abs(standard.std() - 1) < 3 / (2 * standard.size) ** 0.5 + FLOAT16_VALUE


def test_sixteen_bits_keep_what_eight_round_away(make):
    eight, sixteen = make(aperture=(1.0,)), make(aperture=(1.0,), bits=16)
    assert check_dataset(sixteen) == []
    a, b = (read_image(folder / "images" / f"{VIEWS[0]}.png") for folder in (eight, sixteen))
    assert 0 < np.abs(a - b).max() <= 0.5 * LEVEL_8BIT + FLOAT32_VALUE
    assert not np.array_equal(np.round(b * 255), b * 255)


def test_the_layered_renderer_keeps_the_background_off_the_foreground(make):
    plain, layered = (
        make(focus=(1.0,), aperture=(1.0,)),
        make(focus=(1.0,), aperture=(1.0,), renderer="layered", layers=4),
    )
    assert check_dataset(layered) == []
    record = lens_file(layered)
    assert (record["renderer"], record["layers"]) == ("layered", 4)
    sharp, z = read_image(layered / "all_in_focus" / "v02.png"), read_exr(layered / "depth" / "v02.exr")
    in_focus = z < z.min() + 0.1
    error = [np.abs(read_image(folder / "images" / "v02.png") - sharp)[in_focus].mean() for folder in (plain, layered)]
    assert error[1] < 0.5 * error[0]


def test_held_out_and_continuous_lenses(make):
    views = lens_file(make(assign="held-out", focus=(0.2, 0.8), test_focus=(0.5,)))["views"]
    assert {view["focus"] for view in views if view["split"] == "test"} == {0.5}
    assert {view["focus"] for view in views if view["split"] == "train"} == {0.2, 0.8}
    drawn = lens_file(make(assign="continuous", focus=(0.3, 0.6), aperture=(1.0,)))["views"]
    assert len({view["focus"] for view in drawn}) == len(drawn)
    assert all(0.3 <= view["focus"] <= 0.6 for view in drawn)


def test_lens_numbers_agree_with_each_other(dataset_folder):
    lenses = lens_file(dataset_folder)
    q_min, q_max = lenses["disparity_range"]
    every = np.stack([read_exr(dataset_folder / "depth" / f"{name}.exr") for name in VIEWS]).astype(np.float64)
    assert (q_min, q_max) == near(tuple(np.percentile(1 / every, [1, 99])))
    for record in lenses["views"]:
        assert record["k_px"] == near(0.02 * 128 * record["aperture"])
        assert record["aperture_scene"] == near(record["k_px"] / (q_max - q_min))
        assert 1 / record["focus_scene"] == near(q_min + record["focus"] * (q_max - q_min))


def test_what_goes_in_comes_out(dataset_folder, scene):
    given, made = load_scene(scene), load_scene(dataset_folder)
    assert [view.split for view in given.views] == [view.split for view in made.views]
    for before, after in zip(given.views, made.views, strict=True):
        np.testing.assert_array_equal(before.depth(), after.depth())
        np.testing.assert_allclose(before.camera.world_to_camera, after.camera.world_to_camera, atol=POSE_ROUND_TRIP)
        np.testing.assert_array_equal(
            before.image(), read_image(dataset_folder / "all_in_focus" / f"{before.name}.png")
        )
    np.testing.assert_allclose(made.points.xyz, given.points.xyz)


@pytest.mark.parametrize("layout", ["colmap", "llff"])
def test_other_programs_layouts_hold_the_same_cameras(dataset_folder, layout):
    reference, other = load_scene(dataset_folder), load_scene(dataset_folder, layout=layout, images="images")
    for one, two in zip(reference.views, other.views, strict=True):
        assert one.name == two.name
        np.testing.assert_allclose(one.camera.world_to_camera, two.camera.world_to_camera, atol=POSE_ROUND_TRIP)
        np.testing.assert_allclose(one.camera.intrinsics, two.camera.intrinsics)


def test_per_view_normaliser_is_converted_to_the_scenes_units(make):
    folder = make(normaliser="view", focus=(0.8,), aperture=(1.0,))
    lenses = lens_file(folder)
    q_min, q_max = lenses["disparity_range"]
    for record in lenses["views"]:
        z = read_exr(folder / "depth" / f"{record['name']}.exr").astype(np.float64)
        low, high = (1 / z).min(), np.percentile(1 / z, 95)
        assert record["dealt"] == {"aperture": 1, "focus": 0.8, "disparity_range": near([low, high])}
        assert 1 / record["focus_scene"] == near(low + 0.8 * (high - low))
        assert record["aperture_scene"] == near(0.02 * 128 / (high - low))
        assert record["focus"] == near((1 / record["focus_scene"] - q_min) / (q_max - q_min))


def test_a_closed_aperture_gives_the_original_bit_for_bit(make):
    folder = make(aperture=(0.0,))
    for name in VIEWS:
        assert (folder / f"images/{name}.png").read_bytes() == (folder / f"all_in_focus/{name}.png").read_bytes()


def test_options_take_effect(make):
    folder = make(width=64, hold=2, assign="fixed", focus=(0.5,), aperture=(1.0,), linear="exr-float", seed=3)
    lenses = lens_file(folder)
    assert {(record["aperture"], record["focus"], record["k_px"]) for record in lenses["views"]} == {(1, 0.5, 1.28)}
    assert [record["split"] for record in lenses["views"]] == ["test", "train"] * 3
    linear, encoded = (
        read(folder / name) for read, name in ((read_exr, "images_linear/v01.exr"), (read_image, "images/v01.png"))
    )
    assert linear.shape == (48, 64, 3)
    assert np.abs(linear ** (1 / 2.2) - encoded).max() <= 0.5 * LEVEL_8BIT + FLOAT32_VALUE
    assert "--assign fixed" in json.loads((folder / "dataset.json").read_text())["command"]


def test_unknown_depth_blurs_as_infinitely_far(write_scene, tmp_path):
    root = write_scene(tmp_path / "holes")
    z = read_exr(root / "depth/v01.exr")
    z[30:40, 20:50] = 0
    write_exr(root / "depth/v01.exr", z)
    folder = make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out", aperture=(1.0,)), progress=Silent())
    lenses = lens_file(folder)
    record = lenses["views"][1]
    assert (read_exr(folder / "depth/v01.exr") == 0).sum() == 300
    at_infinity = record["aperture_scene"] / record["focus_scene"]
    assert record["max_coc_px"] >= at_infinity * (1 - FLOAT64_VALUE)
    assert recomputed_psnr(folder, record, lenses) >= RECOMPUTED_PSNR
    assert check_dataset(folder) == []


def test_nothing_of_the_machine_is_written(dataset_folder, scene, contents):
    today = datetime.now().strftime("%Y:%m:%d")  # as image headers write it
    for name, data in contents(dataset_folder).items():
        for secret in (str(scene.parent), str(dataset_folder.parent), today):
            assert secret.encode() not in data, name


def test_llff_scene_with_depth_from_a_reconstruction(real_data, monkeypatch, tmp_path):
    """The LLFF path at a small size, with a plane where a training of minutes would be."""

    class Plane:
        id = "splat"
        confidence = "none"

        def estimate(self, view):
            plane = np.full((view.camera.height, view.camera.width), 40.0, np.float32)
            return DepthEstimate(plane, np.ones_like(plane))

        def provenance(self):
            return {"from": "a plane"}

    monkeypatch.setattr(depth_sources, "open_source", lambda source, scene, **_: Plane())
    folder = make_dataset(MakeDataset(scene=str(real_data("llff_fern")), width=126, out=tmp_path), progress=Silent())
    assert check_dataset(folder) == []
    lenses = lens_file(folder)
    assert [record["split"] for record in lenses["views"]].count("test") == 3
    assert recomputed_psnr(folder, lenses["views"][1], lenses) >= RECOMPUTED_PSNR
    made = load_scene(folder)
    assert made.views[0].camera.width == 126 and len(made.points) == 10091


# ---- wrong input is one line ----


@pytest.mark.parametrize(
    "options, word",
    [
        ({"scene": "nowhere"}, "nowhere"),
        ({"width": 1000}, "128"),
        ({"images": "photos"}, "photos"),
        ({"layout": "llff"}, "poses_bounds.npy"),
    ],
)
def test_wrong_input(make, options, word):
    with pytest.raises(InputError) as caught:
        make(**options)
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_given_depth_must_be_there(write_scene, tmp_path):
    root = write_scene(tmp_path / "flat", depth=False)
    with pytest.raises(InputError, match="no depth for 6 of 6 views"):
        make_dataset(MakeDataset(scene=str(root), depth="given", out=tmp_path / "out"), progress=Silent())
    assert not (tmp_path / "out").exists()


def test_depth_must_be_known_somewhere(write_scene, tmp_path):
    root = write_scene(tmp_path / "blank")
    write_exr(root / "depth/v01.exr", np.zeros((96, 128), np.float32))
    with pytest.raises(InputError, match=r"v01\.exr: found no pixel of known depth"):
        make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent())


def test_an_image_must_be_encoded(write_scene, tmp_path):
    root = write_scene(tmp_path / "bright")
    image = read_image(root / "images/v02.png") * 4
    (root / "images/v02.png").unlink()
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], 3, "float")
    spec.attribute("oiio:ColorSpace", "sRGB")  # else it would be linear light, of which 4 is a possible value
    output = oiio.ImageOutput.create(str(root / "images/v02.exr"))
    assert output.open(str(root / "images/v02.exr"), spec) and output.write_image(image) and output.close()
    text = (root / "transforms.json").read_text()
    (root / "transforms.json").write_text(text.replace("images/v02.png", "images/v02.exr"))
    with pytest.raises(InputError, match="encoded image"):
        make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent())


def test_the_folder_must_be_a_datasets(scene, tmp_path):
    (tmp_path / "full").mkdir()
    write_png(tmp_path / "full" / "holiday.png", np.zeros((2, 2, 3)))
    (tmp_path / "file").write_text("")
    for name in ("full", "file"):
        with pytest.raises(InputError, match=name):
            make_dataset(MakeDataset(scene=str(scene), out=tmp_path / name), progress=Silent())
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["holiday.png"]


def test_progress_without_a_terminal_is_lines(capsys, tmp_path):
    terminal = Terminal(interval=0)
    with terminal.stage("blur", 2) as advance:
        advance(1)
        advance(2)
    terminal.finished(tmp_path, "2 views")
    captured = capsys.readouterr()
    assert captured.out == f"{tmp_path}: 2 views\n"
    assert captured.err.splitlines()[0] == "blur: 0 of 2" and "blur: 1 of 2, estimating the time left" in captured.err
