"""The deal of lenses: even, repeatable, and the same whatever else changes."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from dofbench.synthesis.plan import make_plan

values = st.lists(st.integers(0, 20).map(lambda n: n / 20), min_size=1, max_size=5, unique=True)
splits = st.lists(st.sampled_from(["train", "test"]), min_size=1, max_size=40)


def deal(splits: list[str], focus: list[float], aperture: list[float], seed: int):
    views = [(f"v{i:03d}", split) for i, split in enumerate(splits)]
    return make_plan(views, focus=focus, aperture=aperture, seed=seed)


def spread(counts: Counter, possible: int) -> int:
    """Largest minus smallest count, values that never came up included."""
    return max(counts.values()) - (min(counts.values()) if len(counts) == possible else 0)


@given(splits, values, values, st.integers(0, 5))
def test_cells_and_focus_values_are_dealt_evenly_in_each_split(splits, focus, aperture, seed):
    plan = deal(splits, focus, aperture, seed)
    assert [(view.name, view.split) for view in plan.views] == [(f"v{i:03d}", s) for i, s in enumerate(splits)]
    for split in set(splits):
        lenses = [view.lens for view in plan.views if view.split == split]
        assert spread(Counter(lenses), len(focus) * len(aperture)) <= 1
        assert spread(Counter(lens.focus for lens in lenses), len(focus)) <= 1
        assert all(lens.focus in focus and lens.aperture in aperture for lens in lenses)


@given(splits, values, values, st.integers(0, 5))
def test_the_same_arguments_give_the_same_plan(splits, focus, aperture, seed):
    first, again = (deal(splits, focus, aperture, seed) for _ in range(2))
    assert first == again and first.hash == again.hash


def test_the_whole_grid_is_dealt_when_there_are_views_enough():
    plan = deal(["train"] * 6 + ["test"] * 6, [0.2, 0.5, 0.8], [0.5, 1.0], 0)
    for split in ("train", "test"):
        assert len({view.lens for view in plan.views if view.split == split}) == 6


def test_seeds_deal_differently():
    hashes = {deal(["train"] * 12, [0.2, 0.5, 0.8], [0.5, 1.0], seed).hash for seed in range(8)}
    assert len(hashes) > 4


def test_the_test_deal_goes_on_where_the_training_deal_stopped():
    plan = deal(["train", "train", "test"], [0.2, 0.5, 0.8], [1.0], 0)
    assert {view.lens.focus for view in plan.views} == {0.2, 0.5, 0.8}
