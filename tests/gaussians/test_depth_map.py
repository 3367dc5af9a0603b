"""A depth map keeps what is known, and gives the samples that the whole arrays would."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import frontal

from dofbench.training.common.depth_map import DepthMap, DepthSamples, PositiveMap

SIZES = st.tuples(st.integers(1, 12), st.integers(1, 12))


def arrays(size: tuple[int, int], seed: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    depth = np.where(random.random(size) < share, random.uniform(1, 9, size), 0).astype(np.float32)
    return depth, np.where(random.random(size) < share, random.random(size), 0).astype(np.float32)


@given(SIZES, SIZES, st.integers(0, 999), st.sampled_from([0.0, 0.3, 1.0]), st.booleans())
def test_samples_are_those_of_the_nearest_pixels(
    size: tuple[int, int], goal: tuple[int, int], seed: int, share: float, weighted: bool
) -> None:
    depth, weight = arrays(size, seed, share)
    camera = frontal(goal[1], goal[0], 9.0)
    found = DepthMap(depth, weight if weighted else None).samples(camera)
    rows, columns = (((np.arange(new) + 0.5) * old / new).astype(int) for new, old in zip(goal, size, strict=True))
    near, own = depth[rows[:, None], columns], (weight if weighted else np.ones_like(depth))[rows[:, None], columns]
    expected = np.nonzero((near > 0) & (own > 0))
    assert found.weight is not None and found.most == 1
    assert found.rows.dtype == found.columns.dtype == torch.int32
    assert (found.rows.numpy() == expected[0]).all() and (found.columns.numpy() == expected[1]).all()
    assert (found.depth.numpy() == near[expected]).all() and (found.weight.numpy() == own[expected]).all()


@given(SIZES, st.integers(0, 999), st.sampled_from([0.0, 0.3, 1.0]))
def test_the_arrays_come_back_where_both_are_known(size: tuple[int, int], seed: int, share: float) -> None:
    depth, weight = arrays(size, seed, share)
    known = (depth > 0) & (weight > 0)
    found = DepthMap(depth, weight)
    assert (found.depth == np.where(known, depth, 0)).all() and (found.weight == np.where(known, weight, 0)).all()
    assert (found.known == known).all()
    assert found.nbytes <= -(-depth.size // 8) + 8 * known.sum()
    assert DepthMap(depth, None).nbytes == PositiveMap(depth).nbytes == -(-depth.size // 8) + 4 * (depth > 0).sum()


def test_samples_replace_depths_in_their_pixels() -> None:
    depth = np.full((2, 3), 4.0, np.float32)
    one = torch.tensor([1], dtype=torch.int32)
    changed = DepthMap(depth, np.full((2, 3), 0.5, np.float32)).with_samples(
        DepthSamples(one, one, torch.tensor([7.0]))
    )
    assert changed.depth.tolist() == [[4, 4, 4], [4, 7, 4]] and changed.weight[1].tolist() == [0.5, 1.0, 0.5]


def test_samples_lose_those_under_a_mask_and_keep_their_order() -> None:
    found = DepthMap(np.arange(6, dtype=np.float32).reshape(2, 3), None).samples(frontal(3, 2, 9.0))
    mask = torch.tensor([[True, False, True], [True, True, False]])
    kept = found.within(mask)
    assert kept.depth.tolist() == [2.0, 3.0, 4.0] and kept.most == 1
    assert kept.on("cpu").rows.tolist() == [0, 1, 1]


def test_images_of_more_pixels_than_32_bits_count_are_refused() -> None:
    huge = np.broadcast_to(np.float32(0), (2**16, 2**15))
    with pytest.raises(ValueError, match="2\\^31"):
        DepthMap(huge, None)
