"""Distortion against COLMAP's and OpenCV's own implementations, and images without it."""

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE, GIVEN_AWAY, OPENCV_ALPHA, RESAMPLED, TABLE_PIXEL, UNDISTORTED_PIXEL

from dofbench.core.errors import InputError
from dofbench.scenes.undistort import (
    Intrinsics,
    distort,
    sample_depth,
    source_coordinates,
    undistort_image,
    undistort_points,
    undistorted,
)

WIDTH, HEIGHT = 160, 120
BASE = {"width": WIDTH, "height": HEIGHT, "fx": 150.0, "fy": 153.0, "cx": 77.0, "cy": 63.0}
LENSES = {
    "barrel": Intrinsics(**BASE, distortion=(-0.12, 0.02, 0.0, 0.0)),
    "pincushion": Intrinsics(**BASE, distortion=(0.06, 0.01)),
    "opencv": Intrinsics(**BASE, distortion=(0.058, -0.081, -0.004, 0.003, 0.02)),
    "rational": Intrinsics(**BASE, distortion=(0.1, -0.05, 0.001, -0.002, 0.01, 0.08, 0.02, 0.005)),
    "fisheye": Intrinsics(**BASE, distortion=(0.03, -0.01, 0.002, 0.0), fisheye=True),
}
PYCOLMAP = {"barrel": "OPENCV", "pincushion": "RADIAL", "rational": "FULL_OPENCV", "fisheye": "OPENCV_FISHEYE"}
lenses = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)


def rays(count=200):
    return np.random.default_rng(0).uniform(-0.5, 0.5, (count, 2))


def to_pixels(lens, xy):
    return distort(lens, xy) * (lens.fx, lens.fy) + (lens.cx, lens.cy)


@pytest.mark.parametrize("name", PYCOLMAP)
def test_distortion_is_colmaps(name):
    lens = LENSES[name]
    camera = pycolmap.Camera(
        camera_id=1,
        model=PYCOLMAP[name],
        width=WIDTH,
        height=HEIGHT,
        params=(
            [lens.fx, lens.cx, lens.cy, *lens.distortion]
            if PYCOLMAP[name] == "RADIAL"
            else [lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion]
        ),
    )
    if PYCOLMAP[name] == "RADIAL":
        lens = Intrinsics(WIDTH, HEIGHT, lens.fx, lens.fx, lens.cx, lens.cy, lens.distortion)
    expected = camera.img_from_cam(np.column_stack([rays(), np.ones(len(rays()))]))
    np.testing.assert_allclose(to_pixels(lens, rays()), expected, atol=FLOAT64_VALUE)


@lenses
def test_distortion_is_opencvs_but_for_half_a_pixel(lens):
    matrix = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    points = np.column_stack([rays(), np.ones(len(rays()))])[:, None]
    coefficients = np.array(lens.distortion)
    if lens.fisheye:
        expected, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)
    else:
        coefficients = np.pad(coefficients, (0, {2: 2, 4: 0, 5: 0, 8: 0}[len(coefficients)]))
        expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)
    np.testing.assert_allclose(to_pixels(lens, rays()), expected[:, 0] + 0.5, atol=FLOAT64_VALUE)


@lenses
def test_inverse(lens):
    pixels = np.random.default_rng(1).uniform(0, (WIDTH, HEIGHT), (500, 2))
    np.testing.assert_allclose(to_pixels(lens, undistort_points(lens, pixels)), pixels, atol=UNDISTORTED_PIXEL)


@lenses
def test_projected_points_land_where_the_undistorted_image_shows_them(lens):
    """A 3D point seen through the distorted lens is found again through the table of the straight image."""
    straight = undistorted(lens)
    table = source_coordinates(lens, straight)
    row, column = np.random.default_rng(2).integers(0, (HEIGHT, WIDTH), (300, 2)).T
    xy = (np.column_stack([column, row]) + 0.5 - (straight.cx, straight.cy)) / (straight.fx, straight.fy)
    depth = np.random.default_rng(3).uniform(1, 50, 300)
    points = np.column_stack([xy, np.ones(300)]) * depth[:, None]
    pixels, _ = straight.camera(np.eye(4)).project(points)
    np.testing.assert_allclose(pixels, np.column_stack([column, row]) + 0.5, atol=UNDISTORTED_PIXEL)
    seen = to_pixels(lens, points[:, :2] / points[:, 2:])
    np.testing.assert_allclose(table[row, column], seen, rtol=FLOAT32_VALUE)


@lenses
def test_no_pixel_comes_from_outside_and_none_is_given_away(lens):
    straight = undistorted(lens)
    table = source_coordinates(lens, straight).astype(np.float64)
    assert table.min() >= 0.5 - TABLE_PIXEL
    assert table[..., 0].max() <= WIDTH - 0.5 + TABLE_PIXEL
    assert table[..., 1].max() <= HEIGHT - 0.5 + TABLE_PIXEL
    # One axis at least reaches the border on both sides: the view is as wide as it can be.
    low, high = table.min(axis=(0, 1)), table.max(axis=(0, 1))
    reach_x, reach_y = (low < 0.5 + GIVEN_AWAY) & (high > np.array([WIDTH, HEIGHT]) - 0.5 - GIVEN_AWAY)
    assert reach_x or reach_y
    assert straight.fx / straight.fy == pytest.approx(lens.fx / lens.fy, rel=FLOAT64_VALUE)
    assert (straight.width, straight.height) == (WIDTH, HEIGHT)


def test_new_camera_is_near_opencvs_with_alpha_0():
    lens = LENSES["barrel"]
    matrix = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    theirs, _ = cv2.getOptimalNewCameraMatrix(matrix, np.array(lens.distortion), (WIDTH, HEIGHT), 0)
    ours = undistorted(lens)
    # Theirs stretches each axis by itself; ours takes the greater of the two for both.
    assert max(theirs[0, 0] / lens.fx, theirs[1, 1] / lens.fy) == pytest.approx(ours.fx / lens.fx, rel=OPENCV_ALPHA)


@lenses
def test_image_of_a_function_is_the_function_of_the_table(lens):
    """Every pixel's value says where it was: half a pixel of misplacement would show."""

    def scene(x, y):
        waves = [np.sin(x * 2 * np.pi / 40), np.cos(y * 2 * np.pi / 40), np.sin((x + y) * 2 * np.pi / 60)]
        return (0.5 + 0.4 * np.stack(waves, axis=-1)).astype(np.float32)

    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    table = source_coordinates(lens, undistorted(lens))
    straight = undistort_image(scene(x, y), lens)
    inner = (slice(6, -6), slice(6, -6))  # near the border, sampling repeats the last pixel
    np.testing.assert_allclose(straight[inner], scene(table[..., 0], table[..., 1])[inner], atol=RESAMPLED)
    assert straight.dtype == np.float32


def test_overshoot_stays_within_the_images_own_values():
    lens = LENSES["opencv"]
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    image[:, ::2] = 1.0
    straight = undistort_image(image, lens)
    assert straight.min() >= 0.0 and straight.max() <= 1.0


@lenses
def test_depth_is_sampled_not_averaged_at_any_size(lens):
    rng = np.random.default_rng(0)
    for height, width in ((HEIGHT, WIDTH), (HEIGHT // 2, WIDTH // 2)):
        depth = rng.choice(np.array([0.0, 1.0, 7.0], np.float32), (height, width))
        target = undistorted(lens).resized(80, 60)
        sampled = sample_depth(depth, lens, target)
        assert sampled.shape == (60, 80)
        assert set(np.unique(sampled)) <= {0.0, 1.0, 7.0}
        xy = (np.array([40, 30]) + 0.5 - (target.cx, target.cy)) / (target.fx, target.fy)
        column, row = np.floor(to_pixels(lens, xy) * (width / WIDTH, height / HEIGHT)).astype(int)
        assert sampled[30, 40] == depth[row, column]


def test_without_distortion_nothing_happens():
    lens = Intrinsics(**BASE, distortion=(0.0, 0.0, 0.0, 0.0))
    image = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    assert undistorted(lens) is lens
    assert undistort_image(image, lens) is image


@given(st.floats(-1e-7, 1e-7), st.floats(-1e-7, 1e-7))
def test_vanishing_distortion_is_the_pinhole(k1, p1):
    straight = undistorted(Intrinsics(**BASE, distortion=(k1, 0.0, p1, 0.0)))
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(straight, name) == pytest.approx(BASE[name], rel=FLOAT32_VALUE)


@pytest.mark.parametrize("distortion", [(-2.0,), (0.0, -8.0), (-0.9, 0.0, 0.3, 0.3), (float("nan"),)])
def test_a_lens_that_folds_the_image_over_is_refused(distortion):
    with pytest.raises(InputError, match="undone over the whole image|without borders"):
        undistorted(Intrinsics(**BASE, distortion=distortion))


def test_camera_of_a_distorted_lens_is_refused():
    with pytest.raises(ValueError, match="undistorted"):
        LENSES["opencv"].camera(np.eye(4))
    with pytest.raises(ValueError, match="pinhole"):
        source_coordinates(LENSES["opencv"], LENSES["opencv"])
