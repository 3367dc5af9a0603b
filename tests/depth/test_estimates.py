"""The sources sfm and onnx on scenes whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import cloud, frontal, scene_of
from onnx_networks import mean_of_channels, write_network
from scipy.spatial import cKDTree
from scipy.stats import spearmanr
from tolerances import BY_CHANCE, COMPLETED_SCALE, FLOAT32_SCALAR, NETWORK_DISPARITY

from dofbench.core.content import content_folder
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.datasets.synthesis.depth_sources import open_source
from dofbench.scenes import load_scene
from dofbench.scenes.depth.sightings import scene_sightings

WIDTH, HEIGHT = 64, 48
NEAR, FAR = 1.0, 4.0
CAMERAS = [frontal(WIDTH, HEIGHT, 60.0)] * 3


def ramp():
    """z (H, W) of a surface whose disparity rises from left to right."""
    return np.tile(1 / np.linspace(1 / FAR, 1 / NEAR, WIDTH), (HEIGHT, 1))


def points(count, seen_by, seed=0):
    """Points on the ramp, seen by some views."""
    x, y = np.random.default_rng(seed).uniform((1, 1), (WIDTH - 1, HEIGHT - 1), (count, 2)).T
    z = 1 / np.interp(x, np.arange(WIDTH) + 0.5, np.linspace(1 / FAR, 1 / NEAR, WIDTH))
    xyz = np.stack([(x - WIDTH / 2) / 60 * z, (y - HEIGHT / 2) / 60 * z, z], axis=1)
    tracks = None if seen_by is None else tuple(np.array(seen_by) for _ in range(count))
    return cloud(xyz, tracks, error=0.5)


def scene(points, image=None):
    """Three views of the ramp, whose brightness is a scale and shift of its disparity by default."""
    bright = 0.1 + 0.6 / ramp()
    picture = np.repeat(bright[..., None], 3, axis=2).astype(np.float32) if image is None else image
    return scene_of(CAMERAS, image=picture, points=points, name="ramp")


def opened(kind, there, tmp_path, network=None):
    return open_source(kind, there, steps=1, seed=0, work=tmp_path, network=network)


# ---- sfm ----


@pytest.mark.parametrize("seen_by", [(0, 1, 2), None])
def test_sfm_on_a_ramp(tmp_path, seen_by):
    there = scene(points(150, seen_by))
    estimate = opened("sfm", there, tmp_path).estimate(there.views[1])
    assert estimate.depth.dtype == np.float32 and estimate.depth.shape == (HEIGHT, WIDTH)
    # Between points a surface of even slope is filled in: far better than by the nearest point's disparity, which is
    # off by the slope times the distance.
    sparse = there.points.xyz[:, :2] / there.points.xyz[:, 2:] * 60 + (WIDTH / 2, HEIGHT / 2)
    centres = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1)
    nearest = 1 / there.points.xyz[cKDTree(sparse).query(centres)[1], 2]
    error, crude = (np.abs(found - 1 / ramp()).mean() for found in (1 / estimate.depth, nearest))
    assert error < crude / 2
    assert 0 <= estimate.confidence.min() and estimate.confidence.max() <= 1
    assert estimate.statistics["points"] == 150 and estimate.statistics["clipped"] == 0


def test_a_point_whose_track_leaves_the_view_out_may_be_hidden_there():
    cloud = points(80, (0, 1, 2))
    wrong = replace(cloud, xyz=cloud.xyz * 3, views=tuple(np.array([0]) for _ in range(80)))
    parts = (np.concatenate([getattr(cloud, name), getattr(wrong, name)]) for name in ("xyz", "rgb", "error"))
    both = PointCloud(*parts, views=(*cloud.views, *wrong.views))
    clean, mixed = (scene_sightings(scene(part), "a test").by_view for part in (cloud, both))
    np.testing.assert_array_equal(clean["v1"].disparity, mixed["v1"].disparity)
    assert len(mixed["v0"]) > len(clean["v0"])


def test_confidence_falls_away_from_the_points(tmp_path):
    cloud = points(900, (0, 1, 2))
    left = cloud.xyz[:, 0] / cloud.xyz[:, 2] * 60 + WIDTH / 2 < WIDTH / 3
    tracks = tuple(np.array([0, 1, 2]) for _ in left[left])
    cloud = PointCloud(cloud.xyz[left], cloud.rgb[left], cloud.error[left], tracks)
    confidence = opened("sfm", there := scene(cloud), tmp_path).estimate(there.views[0]).confidence
    assert confidence[:, : WIDTH // 4].mean() > 0.5 > 0.05 > confidence[:, -4:].max()


def test_scene_units_scale_the_depth(tmp_path):
    cloud = points(90, (0, 1, 2))
    one, other = (
        opened("sfm", scene(part), tmp_path).estimate(scene(part).views[0]).depth
        for part in (cloud, replace(cloud, xyz=cloud.xyz * 250))
    )
    np.testing.assert_allclose(other, 250 * one, rtol=COMPLETED_SCALE + FLOAT32_SCALAR)


def test_sfm_on_the_built_in_scene(tmp_path):
    """Against exact depth: far better than a constant, and its confidence sorts the pixels by their error."""
    there = load_scene(content_folder("datasets") / "tabletop", width=160)
    view = there.views[5]
    estimate = opened("sfm", there, tmp_path).estimate(view)
    truth = view.depth()
    error = np.abs(1 / estimate.depth - 1 / truth)
    constant = np.abs(np.median(1 / truth) - 1 / truth)
    assert error.mean() < 0.25 * constant.mean()
    # As many independent pixels as there are points: those between the same points are wrong together.
    ranked = spearmanr(estimate.confidence.ravel(), error.ravel()).statistic
    assert ranked < -BY_CHANCE / np.sqrt(estimate.statistics["points"] - 1)


@pytest.mark.parametrize("cloud", [None, points(0, (0,))])
@pytest.mark.parametrize("kind", ["sfm", "onnx"])
def test_there_must_be_points(tmp_path, kind, cloud):
    network = write_network(tmp_path / "n.onnx")
    with pytest.raises(InputError, match="ramp: found no sparse points"):
        opened(kind, scene(cloud), tmp_path, network)


def test_sfm_of_a_view_that_saw_no_point(tmp_path):
    with pytest.raises(InputError, match="no sparse point that view v1 saw"):
        opened("sfm", scene(points(50, (0, 2))), tmp_path)


def test_wrong_matches_are_left_out():
    cloud = points(120, (0, 1, 2))
    cloud.xyz[3] *= 4.0
    cloud.error[9] = 5.0
    found = scene_sightings(scene(cloud), "a test").by_view["v0"]
    assert found.rejected == 2 and len(found) == 118


# ---- onnx ----


def test_a_network_that_sees_disparity_up_to_scale_and_shift(tmp_path):
    """The image's brightness is the disparity's scale and shift, and the network returns it."""
    network = write_network(tmp_path / "n.onnx")
    there = scene(points(60, (0, 1, 2)))
    estimate = opened("onnx", there, tmp_path, network).estimate(there.views[0])
    np.testing.assert_allclose(1 / estimate.depth, 1 / ramp(), rtol=NETWORK_DISPARITY)
    assert estimate.statistics["scale"] == pytest.approx(1 / 0.6, rel=NETWORK_DISPARITY)
    assert estimate.statistics["shift"] == pytest.approx(-0.1 / 0.6, rel=NETWORK_DISPARITY)
    assert estimate.confidence.min() > 0.99 and estimate.statistics["shared"] == 0


def test_a_network_that_gives_depth_up_to_scale(tmp_path):
    network = write_network(
        tmp_path / "n.onnx",
        lambda image: 7.0 / (mean_of_channels(image) - 0.1),
        side='longest = 64\noutput = "depth"\nalign = "scale"\n',
    )
    there = scene(points(60, (0, 1, 2)))
    estimate = opened("onnx", there, tmp_path, network).estimate(there.views[0])
    np.testing.assert_allclose(estimate.depth, ramp(), rtol=NETWORK_DISPARITY)


def test_a_network_in_scene_units_needs_no_points(tmp_path):
    network = write_network(
        tmp_path / "n.onnx",
        lambda image: 0.6 / (mean_of_channels(image) - 0.1),
        side='longest = 64\noutput = "depth"\nalign = "none"\n',
    )
    there = scene(None)
    estimate = opened("onnx", there, tmp_path, network).estimate(there.views[0])
    np.testing.assert_allclose(estimate.depth, ramp(), rtol=NETWORK_DISPARITY)
    assert set(np.unique(estimate.confidence)) == {0.5}


def test_a_view_with_few_points_borrows_from_the_others(tmp_path):
    network = write_network(tmp_path / "n.onnx")
    there = scene(points(60, (0, 2)))
    source = opened("onnx", there, tmp_path, network)
    estimate = source.estimate(there.views[1])
    np.testing.assert_allclose(1 / estimate.depth, 1 / ramp(), rtol=NETWORK_DISPARITY)
    assert estimate.statistics["shared"] == 1 and estimate.statistics["points"] == 0
    assert estimate.confidence.max() == 0.5


def test_confidence_falls_where_the_network_misses_the_points(tmp_path):
    picture = np.repeat((0.1 + 0.6 / ramp())[..., None], 3, axis=2).astype(np.float32)
    picture[:, :16] += 0.3
    there = scene(points(300, (0, 1, 2)), picture)
    confidence = opened("onnx", there, tmp_path, write_network(tmp_path / "n.onnx")).estimate(there.views[0]).confidence
    assert confidence[:, :12].max() < 0.2 < 0.9 < confidence[:, 36:].min()


def test_disparity_that_is_not_positive_is_raised_and_counted(tmp_path):
    picture = np.repeat((0.1 + 0.6 / ramp())[..., None], 3, axis=2).astype(np.float32)
    picture[:12] = 0
    there = scene(points(300, (0, 1, 2)), picture)
    estimate = opened("onnx", there, tmp_path, write_network(tmp_path / "n.onnx")).estimate(there.views[0])
    assert estimate.statistics["clipped"] == pytest.approx(0.25)
    assert np.isfinite(estimate.depth).all() and estimate.depth.min() > 0
    floor = scene_sightings(there, "a test").floor
    np.testing.assert_allclose(estimate.depth[:11], 1 / floor, rtol=FLOAT32_SCALAR)


def test_a_network_that_says_the_opposite(tmp_path):
    network = write_network(tmp_path / "n.onnx", lambda image: 1 - mean_of_channels(image))
    with pytest.raises(InputError, match="does not follow the 180 sightings.*is it disparity"):
        opened("onnx", scene(points(60, (0, 1, 2))), tmp_path, network)


def test_the_network_runs_once(tmp_path, monkeypatch):
    from dofbench.scenes.depth import onnx

    network = write_network(tmp_path / "n.onnx")
    there = scene(points(60, (0, 1, 2)))
    first = opened("onnx", there, tmp_path, network).estimate(there.views[2])
    monkeypatch.setattr(onnx.Network, "predict", None)
    again = opened("onnx", there, tmp_path, network).estimate(there.views[2])
    np.testing.assert_array_equal(first.depth, again.depth)
