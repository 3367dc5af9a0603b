"""The streamed percentiles are numpy's, to the last bit that matters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.lens import DisparityRange
from dofbench.scenes.depth.disparity import scene_range, view_range

depths = st.one_of(
    st.just(0.0), st.sampled_from([1.0, 2.0, 3.0]), st.floats(2.0**-10, 1e6, width=32), st.just(float(np.inf))
)


@given(st.lists(st.lists(depths, min_size=1, max_size=30), min_size=1, max_size=6))
def test_scene_range_is_the_percentile_of_all_pixels_at_once(rows):
    maps = [np.array([row], dtype=np.float32) for row in rows]
    every = np.concatenate([depth.ravel() for depth in maps]).astype(np.float64)
    known = every[(every > 0) & np.isfinite(every)]
    if known.size == 0:
        with pytest.raises(ValueError, match="at least one pixel"):
            scene_range(lambda: maps)
        return
    expected, found = DisparityRange.of_disparity(1.0 / known), scene_range(lambda: maps)
    assert found.q_min == pytest.approx(expected.q_min, rel=FLOAT64_VALUE)
    assert found.q_max == pytest.approx(expected.q_max, rel=FLOAT64_VALUE)


def test_scene_range_of_many_close_depths():
    """Thousands of values that share their upper half of bits."""
    generator = np.random.default_rng(1)
    maps = [generator.uniform(3.0, 3.001, (50, 60)).astype(np.float32) for _ in range(3)]
    expected = DisparityRange.of_disparity(1.0 / np.stack(maps).astype(np.float64))
    found = scene_range(lambda: iter(maps))
    assert (found.q_min, found.q_max) == pytest.approx((expected.q_min, expected.q_max), rel=FLOAT64_VALUE)


def test_view_range_is_minimum_and_95th_percentile():
    depth = np.linspace(1, 5, 101, dtype=np.float32)[None]
    found = view_range(depth)
    disparity = 1 / depth[0].astype(np.float64)
    assert found.q_min == pytest.approx(0.2, rel=FLOAT64_VALUE)
    assert found.q_max == pytest.approx(np.percentile(disparity, 95), rel=FLOAT64_VALUE)
