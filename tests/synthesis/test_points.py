"""Points that a method gets: which of the scene's, and points triangulated between the training photographs alone."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from relisted import write_again
from tolerances import POSE_ROUND_TRIP, TRIANGULATED_DEPTH

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import write_png
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import Dataset, builder, check_dataset, make_dataset, method_points
from dofbench.datasets.synthesis.dataset_options import MakeDataset, MakeDatasets
from dofbench.datasets.synthesis.method_points import LEAST_POINTS, triangulated_between
from dofbench.datasets.synthesis.remake import make_again
from dofbench.datasets.synthesis.several_datasets import planned
from dofbench.scenes import load_scene

TEST, TRAIN = ("v00", "v03"), ("v01", "v02", "v04", "v05")


def made(scene: Path, out: Path, **options) -> Path:
    """A dataset of the scene."""
    return make_dataset(MakeDataset(scene=str(scene), out=out, **options), progress=Silent())


@pytest.fixture(autouse=True, scope="module")
def _few_corners_do() -> Iterator[None]:
    """The planes of these tests are small, and have some ninety points."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method_points, "LEAST_POINTS", 50)
        yield


@pytest.fixture(scope="module")
def shallow(scene: Path, dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of the scene with points from its shallow training photographs. Nobody writes to it."""
    return made(scene, tmp_path_factory.mktemp("points") / "planes", points="shallow", reuse=dataset_folder)


@pytest.fixture(scope="module")
def sharp(scene: Path, dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with points from the sharp photographs of the training views. Nobody writes to it."""
    return made(scene, tmp_path_factory.mktemp("points") / "planes", points="sharp", reuse=dataset_folder)


@pytest.fixture
def folder(shallow: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return shutil.copytree(shallow, tmp_path / "copy")


def seal(folder: Path, **points: object) -> None:
    """Bring the manifest's checksums up to date, and change its record of the points."""
    manifest = json.loads((folder / "dataset.json").read_text())
    for name, record in manifest["files"].items():
        record.update(sha256=sha256_file(folder / name), size=(folder / name).stat().st_size)
    manifest["points"].update(points)
    write_again(folder / "dataset.json", manifest)


def noise(path: Path) -> None:
    """Put noise in an image's place."""
    generator = np.random.default_rng(sum(path.name.encode()))
    write_png(path, generator.uniform(size=(96, 128, 3)).astype(np.float32))


# ---- the scene's own points ----


def colmap_text(root: Path, tracks: dict[int, tuple[int, ...]]) -> Path:
    """A scene as COLMAP writes it, in text: six photographs side by side, and points with these tracks of image ids,
    empty where nobody knows them. Written by hand, so that nothing of ours decides what a track is."""
    model = root / "sparse/0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 SIMPLE_PINHOLE 64 48 60 32 24\n")
    xyz = {point: ((point % 5 - 2) * 0.3, (point // 5 - 2) * 0.3, 4.0) for point in tracks}
    lines = []
    seen: dict[int, list[int]] = {}
    for image in range(1, 7):
        mine = seen[image] = [point for point, track in tracks.items() if image in track]
        where = 0.1 * image
        pixels = [(60 * (xyz[p][0] - where) / 4 + 32, 60 * xyz[p][1] / 4 + 24, p) for p in mine]
        lines += [
            f"{image} 1 0 0 0 {-where} 0 0 1 v{image - 1:02d}.png",
            " ".join(f"{x} {y} {point}" for x, y, point in pixels),
        ]
        write_png(root / f"images/v{image - 1:02d}.png", np.full((48, 64, 3), 0.1 * image, np.float32))
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text(
        "".join(
            f"{point} {x} {y} {z} 100 100 100 0.5 "
            + " ".join(f"{image} {seen[image].index(point)}" for image in tracks[point])
            + "\n"
            for point, (x, y, z) in xyz.items()
        )
    )
    return root


def test_points_that_only_test_views_saw_are_not_given_where_colmap_has_tracks(tmp_path: Path) -> None:
    # Views 0 and 3 are test views: COLMAP's images 1 and 4.
    tracks = {1: (1, 4), 2: (1, 2), 3: (2, 3, 4), 4: (5, 6), 5: (4, 1)}
    root = colmap_text(tmp_path / "tracked", tracks)
    scene = load_scene(root, hold=3)
    assert [view.name for view in scene.test_views()] == list(TEST)
    expected = load_scene(root).points.xyz[[1, 2, 3]]
    np.testing.assert_array_equal(scene.training_set().points.xyz, expected)

    dataset = Dataset.load(made(root, tmp_path / "out", photographs="shallow", hold=3))
    given = dataset.training_set().points
    np.testing.assert_array_equal(given.xyz, expected)
    # Views 1, 2, 4, 5 are training views 0 to 3.
    assert [track.tolist() for track in given.views] == [[0], [0, 1], [2, 3]]
    assert len(dataset.points) == 5
    record = dataset.points_record
    assert (record.origin, record.views, record.tracks) == ("structure from motion", "all", "known")
    assert (record.only_test_views, record.count, record.given) == ("left out", 5, 3)
    readme = " ".join((tmp_path / "out/README.md").read_text().split())
    assert "structure from motion on the images of all views, test views included" in readme
    assert "Points that only test views saw aren't given to a method." in readme
    assert "`sparse/0` has all 5 points" in readme
    assert check_dataset(tmp_path / "out") == []


def test_all_points_are_given_where_tracks_are_unknown(tmp_path: Path) -> None:
    root = colmap_text(tmp_path / "dropped", dict.fromkeys(range(1, 6), ()))
    dataset = Dataset.load(made(root, tmp_path / "out", photographs="shallow", hold=3))
    assert len(dataset.training_set().points) == len(dataset.points) == 5
    record = dataset.points_record
    assert (record.tracks, record.only_test_views, record.given) == ("unknown", "given", 5)
    readme = " ".join((tmp_path / "out/README.md").read_text().split())
    assert "so points that only test views saw are given to a method too" in readme and "`sparse/0` has" not in readme


def test_the_usual_statement_of_an_all_in_focus_scene(dataset_folder: Path) -> None:
    readme = " ".join((dataset_folder / "README.md").read_text().split())
    assert (
        "16 points. Points and poses come from structure from motion on the all-in-focus images of all views" in readme
    )
    assert "`sparse/0` has all 20 points" in readme
    assert "points" not in json.loads((dataset_folder / "dataset.json").read_text())["settings"]


def test_a_scene_without_points_says_so(write_scene: Callable[..., Path], tmp_path: Path) -> None:
    root = write_scene(tmp_path / "bare", points=False)
    out = made(root, tmp_path / "out")
    record = Dataset.load(out).points_record
    assert (record.origin, record.poses, record.count, record.given) == ("none", "not stated", 0, 0)
    assert "There are no points" in (out / "README.md").read_text() and check_dataset(out) == []


# ---- points from the training photographs ----


@pytest.mark.parametrize("kind", ["shallow", "sharp"])
def test_triangulated_points_are_of_training_views_alone(kind: str, request: pytest.FixtureRequest) -> None:
    folder = request.getfixturevalue(kind)
    dataset = Dataset.load(folder)
    test = [index for index, view in enumerate(dataset.views) if view.split == "test"]
    assert [dataset.views[index].name for index in test] == list(TEST)
    assert len(dataset.points.seen_by(test)) == 0
    assert min(len(track) for track in dataset.points.views) >= 2
    record = dataset.points_record
    assert (record.origin, record.photographs, record.views) == ("triangulation", kind, "training")
    assert record.count == record.given == len(dataset.training_set().points) >= 50
    assert record.program.startswith("pycolmap ") and record.protocol == f"points from {kind} training photographs"
    readme = " ".join((folder / "README.md").read_text().split())
    assert (
        f"{'all-in-focus' if kind == 'sharp' else kind} images of the training views alone; poses are given" in readme
    )
    assert f"--points {kind}" in readme
    assert check_dataset(folder) == []


def test_triangulated_points_lie_on_what_the_views_see(shallow: Path) -> None:
    dataset = Dataset.load(shallow)
    errors = []
    for index, view in enumerate(dataset.views):
        seen = dataset.points.seen_from(index)
        xy, z = view.camera.project(dataset.points.xyz[seen])
        column, row = np.clip(xy.astype(int), 0, (view.camera.width - 1, view.camera.height - 1)).T
        errors.append(np.abs(z / dataset.depth(view)[row, column] - 1))
    assert np.median(np.concatenate(errors)) < TRIANGULATED_DEPTH


def test_nothing_but_the_points_differs(shallow: Path, dataset_folder: Path, contents: Callable) -> None:
    """Lenses and depth stay those of the truth: an aperture or a focus means the same."""
    before, after = contents(dataset_folder), contents(shallow)
    assert before.keys() == after.keys()
    different = {name for name in before if before[name] != after[name]}
    about_points = {"sparse/0/images.bin", "sparse/0/points3D.bin", "poses_bounds.npy"}
    assert different == {"README.md", "dataset.json"} | about_points


def test_depth_bounds_are_those_of_the_points(shallow: Path, dataset_folder: Path) -> None:
    """The depth of the truth must not reach a method by the bounds that LLFF's layout has."""
    scene = pycolmap.Reconstruction(shallow / "sparse/0")
    found = {}
    for image in scene.images.values():
        seen = [scene.points3D[point.point3D_id].xyz for point in image.get_observation_points2D()]
        z = [(image.cam_from_world() * place)[2] for place in seen]
        if z:
            found[Path(image.name).stem] = np.percentile(z, (0.1, 99.9))
    assert sorted(found) == sorted(TRAIN)
    nearest, farthest = min(near for near, _ in found.values()), max(far for _, far in found.values())
    rows = [found.get(view.name, (nearest, farthest)) for view in Dataset.load(shallow).views]
    before, after = (np.load(folder / "poses_bounds.npy") for folder in (dataset_folder, shallow))
    np.testing.assert_allclose(after[:, 15:], rows, rtol=POSE_ROUND_TRIP)
    np.testing.assert_array_equal(after[:, :15], before[:, :15])


def test_test_photographs_have_no_part_in_the_points(shallow: Path, scene: Path, tmp_path: Path) -> None:
    root = shutil.copytree(scene, tmp_path / "noisy")
    for name in TEST:
        noise(root / f"images/{name}.png")
    points = Dataset.load(made(root, tmp_path / "out", points="shallow")).points
    expected = Dataset.load(shallow).points
    np.testing.assert_array_equal(points.xyz, expected.xyz)
    np.testing.assert_array_equal(points.rgb, expected.rgb)
    assert [track.tolist() for track in points.views] == [track.tolist() for track in expected.views]


def training(folder: Path) -> list[tuple[str, Camera]]:
    return [(view.name, view.camera) for view in Dataset.load(folder).training_views()]


def test_sharp_images_have_no_part_in_points_from_shallow_ones(folder: Path, shallow: Path, tmp_path: Path) -> None:
    expected = Dataset.load(shallow).points.xyz
    for path in (*(folder / "all_in_focus").iterdir(), *(folder / f"images/{name}.png" for name in TEST)):
        noise(path)
    shutil.rmtree(folder / "depth")
    found = triangulated_between(folder, "shallow", training(shallow), tmp_path / "one", Silent())
    np.testing.assert_array_equal(found.xyz, expected)
    # And what does have a part in them is noticed.
    noise(folder / f"images/{TRAIN[0]}.png")
    found = triangulated_between(folder, "shallow", training(shallow), tmp_path / "two", Silent())
    assert found is None or len(found) != len(expected)


def test_too_few_points_are_refused_with_their_number(
    scene: Path, dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(method_points, "LEAST_POINTS", LEAST_POINTS)
    with pytest.raises(InputError) as caught:
        made(scene, tmp_path / "out", points="shallow", reuse=dataset_folder)
    assert re.fullmatch(
        rf"--points shallow: found \d\d points between 4 training photographs, expected at least {LEAST_POINTS}",
        str(caught.value),
    )
    monkeypatch.setattr(method_points, "triangulated_points", lambda *_, **__: None)
    with pytest.raises(InputError, match="found 0 points between 4 training photographs, expected at least 100"):
        made(scene, tmp_path / "out", points="shallow", reuse=dataset_folder)


def test_made_again_from_its_manifest(shallow: Path, scene: Path, tmp_path: Path) -> None:
    asked = MakeDatasets(scenes=(str(scene),), like=shallow / "dataset.json", out=tmp_path / "again")
    assert make_again(asked, Silent()) == []


def test_points_of_another_version_of_pycolmap_are_another_dataset(
    folder: Path, scene: Path, dataset_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert made(scene, folder, points="shallow") == folder
    monkeypatch.setattr(builder, "program", lambda: "pycolmap 0.1")
    with pytest.raises(InputError, match="another dataset"):
        made(scene, folder, points="shallow")
    copy = shutil.copytree(dataset_folder, folder.with_name("usual"))
    assert made(scene, copy) == copy


# ---- from a dataset that exists ----


def test_what_exists_is_copied_and_not_made_again(
    sharp: Path, shallow: Path, scene: Path, tmp_path: Path, contents: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError("made again")

    for part in ("shallow_image", "encoded"):
        monkeypatch.setattr(builder, part, refused)
    assert contents(made(scene, tmp_path / "out", points="shallow", reuse=sharp)) == contents(shallow)


def test_a_damaged_file_is_made_again_and_not_copied(
    dataset_folder: Path, shallow: Path, scene: Path, tmp_path: Path, contents: Callable
) -> None:
    damaged = shutil.copytree(dataset_folder, tmp_path / "damaged")
    noise(damaged / "images/v02.png")
    (damaged / "depth/v01.exr").unlink()
    assert contents(made(scene, tmp_path / "out", points="shallow", reuse=damaged)) == contents(shallow)


@pytest.mark.parametrize("options", [{"focus": (0.4,)}, {"seed": 1}, {"hold": 2}, {"depth": "sfm"}])
def test_a_dataset_that_differs_in_more_is_refused(
    dataset_folder: Path, scene: Path, tmp_path: Path, options: dict
) -> None:
    with pytest.raises(InputError, match=r"--reuse: found .*expected a dataset that differs in --points alone"):
        made(scene, tmp_path / "out", points="shallow", reuse=dataset_folder, **options)


def test_one_dataset_is_reused_for_one(dataset_folder: Path, scene: Path, tmp_path: Path) -> None:
    several = MakeDatasets(scenes=(str(scene),), assign="fixed", reuse=dataset_folder, out=tmp_path)
    with pytest.raises(InputError, match="--reuse: found 6 datasets to make, expected one"):
        planned(several)


# ---- photographs that are shallow already ----


def test_points_of_photographs_that_are_shallow_already(scene: Path, tmp_path: Path) -> None:
    out = made(scene, tmp_path / "out", points="shallow", photographs="shallow")
    record = Dataset.load(out).points_record
    assert (record.origin, record.photographs, record.views) == ("triangulation", "shallow", "training")
    assert check_dataset(out) == []
    for options, word in (
        ({"points": "sharp"}, "--points: found sharp for planes"),
        ({"reuse": out}, "--reuse: found a dataset for planes"),
    ):
        with pytest.raises(InputError, match=word):
            made(scene, tmp_path / "refused", photographs="shallow", **options)


# ---- the check ----


def test_points_of_other_photographs_are_noticed(folder: Path, dataset_folder: Path, sharp: Path) -> None:
    """Every checksum and every figure fits, but the points were triangulated between other photographs."""
    for name in ("images.bin", "points3D.bin"):
        shutil.copyfile(sharp / "sparse/0" / name, folder / "sparse/0" / name)
    count = len(Dataset.load(sharp).points)
    seal(folder, count=count, given=count)
    (problem,) = check_dataset(folder)
    assert problem.startswith("sparse/0: ") and "triangulated again from the shallow training photographs" in problem


@pytest.mark.parametrize(
    "change, word",
    [
        ({"count": 7}, "count of points is"),
        ({"given": 7}, "given of points is"),
        ({"tracks": "unknown"}, "tracks of points is known, unknown in dataset.json"),
        ({"only_test_views": "given"}, "only_test_views of points is left out, given in dataset.json"),
    ],
)
def test_a_record_that_does_not_fit_is_noticed(folder: Path, change: dict, word: str) -> None:
    seal(folder, **change)
    assert any(word in problem for problem in check_dataset(folder))


def test_a_test_view_in_the_tracks_is_noticed(dataset_folder: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(dataset_folder, tmp_path / "copy")
    seal(folder, views="training")
    assert check_dataset(folder) == [
        "sparse/0: 20 points that a test view saw, expected none: dataset.json says training views"
    ]
