"""Confidence and consistency in a dataset: what the manifest says, what check finds, and old datasets."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from onnx_networks import mean_of_channels, write_network
from relisted import write_again
from tolerances import FLOAT32_VALUE, LEVEL_8BIT

from dofbench.cli.app import DONE, FAILED, WRONG_CALL, main
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr, read_image, to_8bit, write_exr, write_grey_png
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import Dataset, check_dataset, depth_record, depth_sources, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.depth_record import check_depth

# The built-in scene has points in every view.
TABLE_TOP = {"scene": "tabletop", "width": 64, "depth": "sfm", "aperture": (0.0,)}
pytestmark = pytest.mark.usefixtures("one_torch_thread")


def manifest(folder):
    return json.loads((folder / "dataset.json").read_text())


@pytest.fixture
def make(scene, tmp_path):
    """`make(**options)`: a dataset of the tiny scene in tmp_path/out."""

    def run(**options):
        return make_dataset(MakeDataset(**{"scene": str(scene), "out": tmp_path / "out", **options}), progress=Silent())

    return run


@pytest.fixture(scope="module")
def table_top(tmp_path_factory):
    """A dataset of the built-in scene. Nobody writes to it."""
    return make_dataset(MakeDataset(**TABLE_TOP, out=tmp_path_factory.mktemp("table") / "top"), progress=Silent())


@pytest.fixture
def folder(dataset_folder, tmp_path):
    """A copy to spoil."""
    return shutil.copytree(dataset_folder, tmp_path / "copy")


def seal(folder):
    """Bring the manifest's checksums up to date, as someone would who hides a change."""
    record = manifest(folder)
    for name, entry in record["files"].items():
        entry.update(sha256=sha256_file(folder / name), size=(folder / name).stat().st_size)
    write_again(folder / "dataset.json", record)


def test_given_depth_is_certain_and_the_views_agree(dataset_folder):
    record = manifest(dataset_folder)["depth"]
    assert [view["view"] for view in record["views"]] == [f"v{index:02d}" for index in range(6)]
    for view in record["views"]:
        assert view["known"] == view["confidence"] == view["confident"] == 1
        assert view["consistency"]["difference"] < FLOAT32_VALUE and view["consistency"]["consistent"] > 0.9
        assert len(view["consistency"]["neighbours"]) == 4
        assert (read_image(dataset_folder / f"confidence/{view['view']}.png") == 1).all()
    assert "1 where the depth is known" in record["confidence"]
    assert np.array_equal(Dataset.load(dataset_folder).confidence("v01"), np.ones((96, 128)))


def test_unknown_depth_has_no_confidence(write_scene, tmp_path):
    root = write_scene(tmp_path / "holes")
    z = read_exr(root / "depth/v01.exr")
    z[30:40, 20:50] = 0
    write_exr(root / "depth/v01.exr", z)
    out = make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent())
    confidence = Dataset.load(out).confidence("v01")
    assert np.array_equal(confidence == 0, z == 0)
    assert manifest(out)["depth"]["views"][1]["known"] == pytest.approx(1 - 300 / z.size)


def test_confidence_must_fit_its_depth(folder):
    write_grey_png(folder / "confidence/v01.png", np.ones((96, 120)))
    z = read_exr(folder / "depth/v02.exr")
    z[5, :7] = 0
    write_exr(folder / "depth/v02.exr", z)
    seal(folder)
    problems = check_depth(Dataset.load(folder))
    assert problems == [
        "confidence/v01.png: shape (96, 120), expected (96, 128), as the depth",
        "confidence/v02.png: 7 pixels of unknown depth with a confidence, expected 0",
    ]


@pytest.mark.parametrize("factor", [1.2, 0.85])
def test_check_flags_a_view_whose_depth_is_scaled(folder, factor):
    path = folder / "depth/v02.exr"
    write_exr(path, read_exr(path) * np.float32(factor))
    seal(folder)
    (problem,) = check_depth(Dataset.load(folder))
    assert problem.startswith("depth/v02.exr: disparity differs by") and "\n" not in problem
    # The lens no longer fits the depth either, so check says so first.
    assert check_dataset(folder) != []


def test_a_dataset_made_of_such_depth_is_flagged_by_the_command(write_scene, tmp_path, capsys):
    root = write_scene(tmp_path / "odd")
    path = root / "depth/v04.exr"
    write_exr(path, read_exr(path) * np.float32(1.2))
    out = make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent())
    assert main(["check", str(out)]) == FAILED
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 1 and "depth/v04.exr: disparity differs by 18" in told[0]
    consistency = manifest(out)["depth"]["views"][4]["consistency"]
    assert consistency["bias"] < -0.15 and consistency["consistent"] < 0.2 and consistency["coc_px"] > 0.1


def test_check_flags_swapped_views(write_scene, tmp_path):
    root = write_scene(tmp_path / "odd")
    first, last = root / "depth/v00.exr", root / "depth/v05.exr"
    one, other = read_exr(first), read_exr(last)
    write_exr(first, np.fliplr(other))
    write_exr(last, np.fliplr(one))
    out = make_dataset(MakeDataset(scene=str(root), out=tmp_path / "out"), progress=Silent())
    assert [problem.split(":")[0] for problem in check_dataset(out)] == ["depth/v00.exr", "depth/v05.exr"]


def test_a_dataset_from_before_there_was_confidence(folder):
    shutil.rmtree(folder / "confidence")
    record = manifest(folder)
    record["files"] = {name: entry for name, entry in record["files"].items() if not name.startswith("confidence")}
    del record["depth"]["views"], record["depth"]["confidence"]
    write_again(folder / "dataset.json", record)
    assert Dataset.load(folder).confidence("v00") is None
    assert check_dataset(folder) == []


def test_a_lost_confidence_map_is_found_and_made_again(make):
    out = make()
    before = (out / "confidence/v03.png").read_bytes(), (out / "dataset.json").read_bytes()
    (out / "confidence/v03.png").unlink()
    assert check_dataset(out) == ["confidence/v03.png: missing"]
    make()
    assert ((out / "confidence/v03.png").read_bytes(), (out / "dataset.json").read_bytes()) == before


@pytest.mark.slow
def test_a_run_that_ends_among_the_views_forgets_nothing(make, monkeypatch, contents, table_top):
    """The statistics of views that an earlier run finished come from that run."""
    open_source, left = depth_sources.open_source, [3]

    def dying(*arguments, **options):
        source = open_source(*arguments, **options)
        estimate = source.estimate

        def until_it_dies(view):
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            return estimate(view)

        monkeypatch.setattr(source, "estimate", until_it_dies, raising=False)
        return source

    monkeypatch.setattr(depth_sources, "open_source", dying)
    with pytest.raises(KeyboardInterrupt):
        make(**TABLE_TOP)
    left[0] = 17  # as many as are missing
    assert contents(make(**TABLE_TOP)) == contents(table_top)


def elsewhere(array, places):
    """The same array at an address that no vector instruction likes."""
    room = np.empty(array.nbytes + 64, np.uint8)
    copy = room[places : places + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


@pytest.mark.slow
def test_the_manifest_follows_from_the_files_whatever_the_last_digits_in_memory(make, monkeypatch, table_top):
    """Sums round differently by machine and by alignment: what comes of that may not reach the manifest."""
    random = np.random.default_rng(0)
    open_source, consistencies, changed = depth_sources.open_source, depth_record.consistencies, []

    def rounded_otherwise(*arguments, **options):
        source = open_source(*arguments, **options)
        estimate = source.estimate

        def estimated(view):
            found = estimate(view)
            noise = 1 + 2e-7 * random.uniform(-1, 1, found.confidence.shape)
            confidence = (found.confidence * noise).astype(np.float32)
            # Near a step between two levels the file itself would be another.
            confidence = np.where(to_8bit(confidence) == to_8bit(found.confidence), confidence, found.confidence)
            changed.append((confidence != found.confidence).mean())
            statistics = {
                name: value * (1 + 1e-12 * (not float(value).is_integer())) for name, value in found.statistics.items()
            }
            return replace(
                found, depth=elsewhere(found.depth, 4), confidence=elsewhere(confidence, 8), statistics=statistics
            )

        monkeypatch.setattr(source, "estimate", estimated, raising=False)
        return source

    def measured_otherwise(names, cameras, depth_of, points, disparity_range, *others, **options):
        turned = [
            replace(camera, world_to_camera=camera.world_to_camera * (1 + 1e-12 * random.uniform(-1, 1, (4, 4))))
            for camera in cameras
        ]
        return consistencies(
            names, turned, lambda index: elsewhere(depth_of(index), 4), points, disparity_range, *others, **options
        )

    monkeypatch.setattr(depth_sources, "open_source", rounded_otherwise)
    monkeypatch.setattr(depth_record, "consistencies", measured_otherwise)
    again = make(**TABLE_TOP)
    assert len(changed) == 20 and min(changed) > 0.5
    assert (again / "dataset.json").read_bytes() == (table_top / "dataset.json").read_bytes()


def test_surfaces_that_agree_exactly_have_no_noise_for_a_figure(dataset_folder):
    for view in manifest(dataset_folder)["depth"]["views"]:
        assert view["consistency"]["bias"] == 0 == view["consistency"]["difference"]


def test_every_figure_of_the_manifest_can_be_computed_again_from_the_files(table_top):
    out, dataset, record = table_top, Dataset.load(table_top), manifest(table_top)["depth"]
    points = dataset.points.seen_by(range(len(dataset.views)))
    agreement = depth_record.consistencies(
        [view.name for view in dataset.views],
        [view.camera for view in dataset.views],
        lambda index: dataset.depth(dataset.views[index]),
        points,
        dataset.disparity_range,
    )
    for view, agrees in zip(record["views"], agreement, strict=True):
        again = depth_record.record_of_files(out, view["view"], view["statistics"])
        again = again.model_copy(update={"consistency": depth_record._consistency_record(agrees)})
        assert again.model_dump(mode="json", exclude_none=True) == view
        # By another way: the mean of the map's grey levels.
        levels = cv2.imread(str(out / f"confidence/{view['view']}.png"), cv2.IMREAD_UNCHANGED)
        assert view["confidence"] == pytest.approx(levels[read_exr(out / f"depth/{view['view']}.exr") > 0].mean() / 255)


@pytest.mark.slow
def test_sfm_from_the_command_line(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["make-dataset", "tabletop", "--width", "80", "--depth", "sfm", "--out", str(out)]) == DONE
    record = manifest(out)["depth"]
    assert record["source"] == "sfm" and record["views"][2]["statistics"]["points"] > 100
    assert "--depth sfm" in manifest(out)["command"]
    assert main(["check", str(out)]) == DONE, capsys.readouterr().out


def test_sfm_needs_points(write_scene, tmp_path, capsys):
    root = write_scene(tmp_path / "bare", points=False)
    assert main(["make-dataset", str(root), "--depth", "sfm", "--out", str(tmp_path / "out")]) == WRONG_CALL
    assert "bare: found no sparse points" in capsys.readouterr().err


def test_a_network_from_the_command_line(write_scene, tmp_path, capsys):
    """The picture of the two planes says nothing of depth, so the network is told by the picture's own depth."""
    root = write_scene(tmp_path / "lit", depth=False)
    points = list(np.linspace(0.2, 0.8, 128))
    picture = np.tile(np.array(points, np.float32)[None, :, None], (96, 1, 3))
    for path in sorted((root / "images").iterdir()):
        write_grey_png(path, picture[..., 0])
    network = write_network(
        tmp_path / "n.onnx",
        mean_of_channels,
        side='title = "brightness"\nlongest = 128\noutput = "disparity"\nalign = "none"\n',
    )
    out = tmp_path / "out"
    assert main(["make-dataset", str(root), "--depth", f"onnx:{network}", "--out", str(out)]) == DONE
    record = manifest(out)["depth"]
    assert record["source"] == "onnx" and record["provenance"]["description"]["title"] == "brightness"
    assert record["provenance"]["network"]["sha256"] == sha256_file(network)
    z = read_exr(out / "depth/v01.exr")
    np.testing.assert_allclose(1 / z, picture[..., 0], atol=LEVEL_8BIT)
    assert "onnx:n.onnx" in manifest(out)["command"] and str(tmp_path) not in (out / "dataset.json").read_text()
    capsys.readouterr()
    # Another side file is another dataset.
    network.with_name("n.onnx.toml").write_text('longest = 64\noutput = "disparity"\nalign = "none"\n')
    assert main(["make-dataset", str(root), "--depth", f"onnx:{network}", "--out", str(out)]) == WRONG_CALL
    assert "another dataset" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ("onnx", "onnx:FILE"),
        ("onnx:", "onnx:FILE"),
        ("onnx:nowhere.onnx", "nowhere.onnx"),
        ("sfm:x", "sfm"),
    ],
)
def test_a_source_that_is_none(make, option, word):
    with pytest.raises(InputError, match=word):
        make(depth=option)
