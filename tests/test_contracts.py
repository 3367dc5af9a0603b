"""What methods are given: where tracks are known, points that the training views saw and no others; else all."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dofbench.core.contracts import PointCloud

VIEWS = 6


def cloud(tracks: list[list[int]] | None, count: int) -> PointCloud:
    xyz = np.arange(3.0 * count).reshape(count, 3)
    views = None if tracks is None else tuple(np.array(track, dtype=np.int64) for track in tracks)
    return PointCloud(xyz, xyz.astype(np.float32), xyz[:, 0].astype(np.float32), views)


@given(
    tracks=st.lists(st.lists(st.integers(0, VIEWS - 1), unique=True).map(sorted), max_size=12),
    kept=st.lists(st.integers(0, VIEWS - 1), unique=True),
)
def test_points_seen_by_some_views(tracks: list[list[int]], kept: list[int]) -> None:
    points = cloud(tracks, len(tracks))
    seen = points.seen_by(kept)
    expected = [index for index, track in enumerate(tracks) if set(track) & set(kept)]
    assert len(seen) == len(expected)
    assert np.array_equal(seen.xyz, points.xyz[expected]) and np.array_equal(seen.rgb, points.rgb[expected])
    assert np.array_equal(seen.error, points.error[expected])
    for track, index in zip(seen.views, expected, strict=True):
        assert {kept[view] for view in track} == set(tracks[index]) & set(kept)
        assert list(track) == sorted(track)


def test_without_tracks_all_points_stay() -> None:
    points = cloud(None, 3)
    assert points.seen_by([1]) is points
