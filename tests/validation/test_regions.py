"""Regions: they partition the picture, and the region of a depth edge is as wide as its blur."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dofbench.evaluation.renderer.renderer_scores import regions


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 5), st.floats(0, 8))
def test_they_share_out_the_inside(seed, border, scale):
    radius = scale * np.random.default_rng(seed).normal(size=(24, 31))
    found = regions(radius, border)
    parts = sum(found[name].astype(int) for name in ("in focus", "blurred", "depth edge"))
    assert np.array_equal(parts, found["all"].astype(int))
    assert found["all"].sum() == (24 - 2 * border) * (31 - 2 * border)


def test_an_edge_reaches_one_circle_of_confusion():
    radius = np.zeros((40, 60))
    radius[:, 30:] = 5.0
    edge = regions(radius, 0)["depth edge"]
    assert edge[20].nonzero()[0].tolist() == list(range(24, 36))
    assert regions(radius, 0)["in focus"][20, :24].all() and regions(radius, 0)["blurred"][20, 36:].all()


def test_a_slope_is_no_edge():
    radius = np.tile(np.linspace(-8, 8, 64), (20, 1))
    assert not regions(radius, 0)["depth edge"].any()
