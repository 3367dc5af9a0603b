"""How large the workloads of the model of kernel times are: by hand, and as they are counted on the CPU."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmark_scripts import script
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tolerances import CSV_DIGITS, FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.lens import ApertureShape

gpu_scatter_windows, gpu_sizes, gpu_sizes_field, gpu_sizes_stereo = map(
    script, ("gpu_scatter_windows", "gpu_sizes", "gpu_sizes_field", "gpu_sizes_stereo")
)

SIZES = gpu_sizes.Sizes("small", 10_000, 64, 48)
FIELD = gpu_sizes_field.FieldSizes("small", 512, 100)


def test_windows_by_hand() -> None:
    """A disc of 2 pixels is followed 4 pixels far, in nine rows of two coarse windows each, from -16 and from 0."""
    found = gpu_scatter_windows.windows(2.0, 0)
    assert (found.rows, found.coarse) == (9, 18)
    # Up to 3.5 pixels away in rows -3 to 3: both windows of a row have a place that near, the others none.
    assert found.coarse_met == 14 / 18
    assert found.fine == 4 * 14 and found.fine_met == 14 / 56 and found.taps == 4 * 14


@settings(max_examples=40, deadline=None)
@given(radius=st.floats(0.0, 60.0), blades=st.sampled_from([0, 5, 6, 8]))
def test_windows_hold_every_rim(radius: float, blades: int) -> None:
    """Every place where a weight is neither 0 nor 1 is gone through by itself, and few are besides."""
    found = gpu_scatter_windows.windows(radius, blades)
    dy, dx = np.mgrid[-80:81, -80:81]
    own = np.hypot(dx, dy) / ApertureShape(blades=blades).radius_factor(np.arctan2(dy, dx))
    rim = (abs(own - radius) < gpu_scatter_windows.BAND - FLOAT64_VALUE) & (np.hypot(dx, dy) <= found.rows // 2)
    assert rim.sum() <= found.taps <= rim.sum() + 20 * found.rows
    assert found.fine % 4 == 0 and found.fine <= 4 * found.coarse


def test_levels_of_a_view() -> None:
    view = gpu_sizes_stereo.StereoSizes("view", 504, 378, 128, 4)
    found = gpu_sizes_stereo.levels(view)
    assert [(one.width, one.height, one.planes) for one in found] == [(126, 94, 33), (252, 189, 65), (504, 378, 128)]
    assert [(one.coarse_width, one.coarse_planes) for one in found] == [(0, 0), (126, 33), (252, 65)]
    # 64 MiB hold the sums of seven planes: 4 * 3 * 4 * 378 * 510 bytes each.
    assert (view.sweeps, view.together) == (19, 128 / 19)


def test_a_grid_is_read_once_at_most() -> None:
    assert FIELD.grid_nodes == 3 * 100 * 100 + 3 * 100
    assert FIELD.read(10, 8) == 4 * 8 * 3 * 6 * 10
    assert FIELD.read(1e9, 8) == 4 * 8 * FIELD.grid_nodes


def test_passes_along_a_ray() -> None:
    """64 steps: four blocks of 16 if all are samples; 24 samples are one and a half and half of the last."""
    assert FIELD.along(24, 16) == 1.5 + 15 / 32
    assert FIELD.along(64, 16) == FIELD.all_along(16) == 4


def test_passes_at_a_grids_nodes() -> None:
    """Three samples in one cell of a plane of 3 x 3 nodes: its four nodes are the corner's, in two programs of four."""
    samples = script("gpu_field_samples")
    cells = np.zeros((3, 3), int)
    passes = samples.plane_passes(cells, 3, 4, 2)
    # Nodes 0, 1, 3 and 4 of each plane of nine meet the cell, two samples a pass.
    met = np.array([n % 9 in (0, 1, 3, 4) for n in range(27)] + [False])
    assert passes.tolist() == [2 if four.any() else 0 for four in met.reshape(-1, 4)]
    assert samples.plane_passes(cells, 3, 1, 8).tolist() == [int(n % 9 in (0, 1, 3, 4)) for n in range(27)]
    # Two cells a line, four programs each: three of them have one of the first cell's samples.
    assert samples.line_passes(cells, 3, 128).tolist() == [1, 1, 1, 0, 0, 0, 0, 0] * 3


def test_what_counts_as_a_launch_of_torch() -> None:
    """Views don't, nor does a sum that is read to see whether values are finite."""
    with script("gpu_torch_calls").Calls() as calls:
        values = torch.ones(6)
        assert float((2 * values).view(2, 3).t().sum()) == 12
    assert calls.count == 2  # ones and product


# ---- footprints on the CPU ----


def record(**values: float) -> np.ndarray:
    """(1, 16), a Gaussian's record with an ellipse in pixels: its centre, its half axes along x and y, opacity 1."""
    layout = script("gpu_footprints").layout
    made = np.zeros((1, layout.RECORD))
    made[0, [layout.MX, layout.MY]] = values["x"], values["y"]
    # The exponent is -(dx / a)**2 - (dy / b)**2, and counts down to -1.
    made[0, [layout.L11, layout.L22, layout.LIMIT]] = 1 / values["a"], 1 / values["b"], -1.0
    return made


CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))


@settings(max_examples=50, deadline=None)
@given(x=st.floats(-20, 84), y=st.floats(-20, 68), a=st.floats(0.3, 40), b=st.floats(0.3, 40))
def test_tiles_that_an_ellipse_meets(x: float, y: float, a: float, b: float) -> None:
    """All tiles with a pixel's centre in the ellipse are listed, and none that the box around it doesn't reach."""
    footprints = script("gpu_footprints")
    column, row = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    inside = ((column - x) / a) ** 2 + ((row - y) / b) ** 2 <= 1 - FLOAT64_VALUE
    boxed = (abs(column - x) <= a + FLOAT64_VALUE) & (abs(row - y) <= b + FLOAT64_VALUE)
    assume(boxed.any())  # others are no candidates
    for k in range(3):
        first, many = footprints.columns_met(record(x=x, y=y, a=a, b=b), k, CAMERA)
        listed = set(range(int(first[0]), int(first[0] + many[0])))
        met, box = (
            {c for c in range(4) if mask[16 * k : 16 * k + 16, 16 * c : 16 * c + 16].any()} for mask in (inside, boxed)
        )
        assert met <= listed <= box


def test_a_tile_is_followed_until_it_is_opaque() -> None:
    """Wide Gaussians of alpha 0.99 leave less than 1e-4 behind the third; it is noticed after sixteen."""
    footprints = script("gpu_footprints")
    wide = record(x=8.0, y=8.0, a=1e4, b=1e4)
    assert footprints.follow(wide, [0] * 40, 0, 4, CAMERA) == (16, 3)
    assert footprints.follow(wide, [0] * 2, 0, 4, CAMERA) == (2, 2)


def test_a_gaussian_that_colours_no_pixel_is_looked_at() -> None:
    beyond = record(x=40.0, y=8.0, a=2.0, b=2.0)
    assert script("gpu_footprints").follow(beyond, [0], 0, 4, CAMERA) == (1, 0)


# ---- the calls that a GPU is measured by ----


def test_the_largest_radius_that_reaches_a_tile() -> None:
    """Source by source."""
    sizes, calls = script("gpu_call_sizes"), script("gpu_calls")
    size = calls.Size(70, 20, radius=3.0)
    radius = calls.scatter(size).inputs[1]
    found = []
    for top, left in ((top, left) for top in (0, 8, 16) for left in (0, 32, 64)):
        rows, columns = range(top, min(top + 8, 20)), range(left, min(left + 32, 70))
        most = 0.0
        for y in range(20):
            for x in range(70):
                nearest = min(max(x, columns[0]), columns[-1]), min(max(y, rows[0]), rows[-1])
                own = abs(float(radius[y, x]))
                if np.hypot(x - nearest[0], y - nearest[1]) <= gpu_scatter_windows.reach_of(own):
                    most = max(most, own)
        found.append(most)
    assert sizes.largest_radii(size) == {"radius": np.mean(found)} and len(set(found)) > 1


def test_samples_that_light_reaches_in_a_call() -> None:
    """Ray by ray: as many as there are before the light is gone."""
    sizes, calls = script("gpu_call_sizes"), script("gpu_calls")
    size = calls.Size(nodes=6, rays=7, samples=90)
    rays = calls.field_rays(size)
    rays.learned[0].mul_(6)  # dense enough for some rays to end
    reached = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calls, "field_rays", lambda size: rays)
        found = sizes.field_samples(size)
    for origin, direction in zip(rays.origins, rays.directions, strict=True):
        light, count = 1.0, 0
        for place in rays.places:
            count += light >= 1e-4
            light *= float(torch.exp(-rays.density((origin + place * direction)[None]).double() * rays.length))
        reached.append(count)
    assert found["looked_at"] == found["lit"] == np.mean(reached) and found["samples"] == 90
    assert min(reached) < 90


def test_gaussians_of_a_call_are_counted_from_every_point_of_the_lens() -> None:
    """A call whose Gaussians are all small and in sight: each meets a tile, or a few of its neighbours."""
    sizes, calls = script("gpu_call_sizes"), script("gpu_calls")
    size = calls.Size(64, 48, gaussians=300)
    pictures = []
    with pytest.MonkeyPatch.context() as patch:
        drawn = script("gpu_footprints").drawn
        patch.setattr(sizes, "drawn", lambda *given: pictures.extend(drawn(*given)) or pictures)
        one = sizes.COUNTED["rasterize"](size)
        assert len(pictures) == 1 and one == pictures[0]
        pictures.clear()
        several = sizes.COUNTED["rasterize_from_points"](size)
    assert len(pictures) == gpu_sizes.LENS_POINTS
    assert several["intersections"] == np.mean([picture["intersections"] for picture in pictures])
    assert 0 < one["visible"] <= 1 <= one["rows"] <= one["intersections"]


def test_what_is_kept_was_counted_from_these_calls() -> None:
    """Of what is counted quickly."""
    sizes, calls = script("gpu_call_sizes"), script("gpu_calls")
    for op in ("scatter", "field"):
        (call,) = sizes.model_calls(op, calls.Size(), script("gpu_times").REPORT)
        for name, value in sizes.COUNTED[op](calls.Size()).items():
            assert getattr(call.sizes, name) == pytest.approx(value, rel=CSV_DIGITS)
