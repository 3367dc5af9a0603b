"""Every tile's list is sorted by depth, whatever its length."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from random_gaussians import scene, view

from dofbench.runtime.ops.rasterize import cpu, op
from dofbench.runtime.ops.rasterize.cpu_lists import sort_keys


@njit
def sort(keys, other, count):  # compiled functions alone may call `internal` ones
    return sort_keys(keys, other, count)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2, 39, 40, 41, 300, 3000]), st.integers(0, 31))
def test_keys_are_sorted_by_their_upper_halves_and_equal_ones_keep_their_order(
    seed: int, count: int, bits: int
) -> None:
    random = np.random.default_rng(seed)
    depth = random.integers(2**31 - 2**bits, 2**31, count).astype(np.uint64)
    keys = depth << np.uint64(32) | np.arange(count, dtype=np.uint64)
    expected = keys[np.argsort(depth, kind="stable")]
    assert np.array_equal(sort(keys.copy(), np.empty_like(keys), count)[:count], expected)


@pytest.mark.parametrize("chunks", [1, 3, 64])
def test_lists_hold_every_intersection_once_nearest_first(chunks: int) -> None:
    """places[offsets[i] …] are where Gaussian i is listed, one place a tile, in the order of the tiles."""
    gaussians = scene(700, 4, size=-2.5)
    gaussians["means"][::3, 2] = 4.0  # equal depths too
    camera = view(90, 70, np.eye(4))
    parameters = tuple(gaussians.values())
    arguments = op._view(parameters, camera, None, 0, None, 0.1, True, "none", 0.2)
    settings = cpu._Settings(arguments)
    records, depths, _, _, counts = cpu._projected(settings, parameters, None, None, np.empty(0, np.float32))
    starts, ids, _, offsets, places = cpu.fill_tiles(
        records, depths, counts, 700, settings.view, settings.columns, settings.rows, chunks
    )
    assert starts[-1] == counts[:700].sum() == len(ids) > 0
    for begin, stop in pairwise(starts):
        listed = ids[begin:stop]
        assert np.array_equal(listed, listed[np.lexsort((listed, depths[listed]))])
    assert np.array_equal(np.sort(places), np.arange(len(ids)))
    for i in range(700):
        own = places[offsets[i] : offsets[i + 1]]
        assert (ids[own] == i).all() and (np.diff(np.searchsorted(starts, own, side="right")) > 0).all()
