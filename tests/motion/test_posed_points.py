"""Points of photographs whose cameras are known: where they lie, what they depend on, and when there are none."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import cloud
from tolerances import TRIANGULATED_DEPTH

from dofbench.core.progress import Silent
from dofbench.scenes.reconstruction import posed_points
from dofbench.scenes.reconstruction.matching import compare, verified
from dofbench.scenes.reconstruction.photograph_list import Photograph, Prepared, prepare
from dofbench.scenes.reconstruction.posed_points import triangulated_points
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct

VIEWS = (6, 8, 7, 9)  # of the built-in scene, out of order on purpose


@pytest.fixture(scope="module")
def photographs(true_scene):
    """Of four views, with their exact cameras."""
    views = [true_scene.views[index] for index in VIEWS]
    return [Photograph(view.name, view.source, view.image, camera=view.camera) for view in views]


@pytest.fixture(scope="module")
def points(photographs, tmp_path_factory):
    """Their points."""
    found = triangulated_points(photographs, tmp_path_factory.mktemp("points") / "work", 0, Silent())
    assert found is not None
    return found


def test_tracks_are_of_the_photographs_in_their_order(points, photographs, true_scene):
    assert len(points) > 100 and all(len(track) > 1 for track in points.views)
    errors = []
    for index, photograph in enumerate(photographs):
        seen = points.seen_from(index)
        xy, z = photograph.camera.project(points.xyz[seen])
        depth = true_scene.views[VIEWS[index]].depth()
        assert photograph.camera.inside(xy).all()
        column, row = xy.astype(int).T
        errors.append(np.abs(z / depth[row, column] - 1))
    assert np.median(np.concatenate(errors)) < TRIANGULATED_DEPTH
    assert np.isfinite(points.error).all() and points.rgb.std() > 0


def test_points_miss_no_view_by_more_than_the_width_allows(points):
    """320 pixels wide: a pixel, where COLMAP would allow four. An error is the mean over a point's views."""
    assert points.error.max() <= 1.0


def test_the_same_photographs_give_the_same_points_whatever_lay_there(points, photographs, tmp_path):
    work = tmp_path / "work"
    (work / "photographs").mkdir(parents=True)
    (work / "photographs/000000.png").write_bytes(b"of another run")
    (work / "database.db").write_bytes(b"of another run")
    again = triangulated_points(photographs, work, 0, Silent())
    for name in ("xyz", "rgb", "error"):
        np.testing.assert_array_equal(getattr(again, name), getattr(points, name))


@pytest.mark.slow
def test_a_tighter_geometry_keeps_fewer_matches(photographs, tmp_path):
    kept = []
    for name, error in (("usual", None), ("tight", 0.5)):
        folder = tmp_path / name
        prepared = prepare(photographs[:3], folder / "photographs", 320, lambda done: None)
        compared = compare(
            folder / "database.db",
            folder / "photographs",
            prepared,
            (),
            Silent(),
            Reconstruct(folder, folder, camera_model="PINHOLE", features=2000),
            error=error,
        )
        assert compared.matching == "exhaustive" and compared.pairs == [(0, 1), (0, 2), (1, 2)]
        kept.append(verified(folder / "database.db", prepared))
    usual, tight = kept
    assert usual.keys() == {(0, 1), (0, 2), (1, 2)} and all(tight.get(pair, 0) < usual[pair] for pair in usual)


def test_a_point_that_one_view_saw_is_none():
    """What lies behind a camera is taken out of its track, which may leave a single view."""
    tracks = [np.array(track) for track in ([0, 1], [2], [], [1, 2, 3])]
    kept = posed_points._agreed(cloud(np.arange(12.0).reshape(4, 3), tracks))
    np.testing.assert_array_equal(kept.xyz, [[0, 1, 2], [9, 10, 11]])
    assert [track.tolist() for track in kept.views] == [[0, 1], [1, 2, 3]] and len(kept.rgb) == len(kept.error) == 2
    assert posed_points._agreed(cloud(np.zeros((1, 3)), [np.array([0])])) is None


@pytest.mark.parametrize("spoil", ["too few", "plain"])
def test_there_may_be_none(photographs, tmp_path, spoil):
    def plain(one):
        shape = (one.camera.height, one.camera.width, 3)
        return Photograph(one.name, one.source, lambda: np.full(shape, 0.5, np.float32), camera=one.camera)

    given: list[Photograph] = photographs[:2] if spoil == "too few" else [plain(one) for one in photographs]
    assert triangulated_points(given, tmp_path / "work", 0, Silent()) is None


@pytest.mark.parametrize(("width", "error"), [(100, 1.0), (400, 1.0), (800, 2.0), (1600, 4.0), (6000, 4.0)])
def test_the_error_grows_with_the_width_up_to_colmaps_own(prepared, width, error):
    assert posed_points._error([prepared(width, width // 2)]) == error
    assert posed_points._error([prepared(width // 2, width)]) == error


@pytest.fixture
def prepared():
    """A photograph of this size."""
    return lambda width, height: Prepared("one", "000000.png", width, height, 1.0, None)
