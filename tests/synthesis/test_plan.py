"""The assignment of lenses to views: even, repeatable, and independent of other settings."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
from tolerances import FOUR_DECIMALS

from dofbench.datasets.synthesis.lens_plan import Values, deal_plan, draw_plan

values = st.lists(st.integers(0, 20).map(lambda n: n / 20), min_size=1, max_size=5, unique=True)
splits = st.lists(st.sampled_from(["train", "test"]), min_size=1, max_size=40)


def deal(splits: list[str], focus: list[float], aperture: list[float], seed: int):
    views = [(f"v{i:03d}", split) for i, split in enumerate(splits)]
    return deal_plan(views, Values(tuple(focus), tuple(aperture)), seed=seed)


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


@given(splits, values, values, values, values, st.integers(0, 5))
def test_held_out_values_go_to_the_test_views_alone(splits, focus, aperture, test_focus, test_aperture, seed):
    views = [(f"v{i:03d}", split) for i, split in enumerate(splits)]
    given, held_out = Values(tuple(focus), tuple(aperture)), Values(tuple(test_focus), tuple(test_aperture))
    plan = deal_plan(views, given, seed=seed, held_out=held_out)
    plain = deal_plan(views, given, seed=seed)
    for view, without in zip(plan.views, plain.views, strict=True):
        expected = held_out if view.split == "test" else given
        assert view.lens.focus in expected.focus and view.lens.aperture in expected.aperture
        assert view.split == "test" or view == without
    tests = [view.lens for view in plan.views if view.split == "test"]
    assert not tests or spread(Counter(tests), len(test_focus) * len(test_aperture)) <= 1


@given(splits, st.tuples(st.floats(0, 1), st.floats(0, 1)), st.integers(0, 5))
def test_drawn_values_cover_their_range_evenly(splits, ends, seed):
    views = [(f"v{i:03d}", split) for i, split in enumerate(splits)]
    plan = draw_plan(views, Values(ends, (0.5,)), seed=seed)
    assert plan == draw_plan(views, Values(ends, (0.5,)), seed=seed)
    low, high = min(ends), max(ends)
    for split in set(splits):
        drawn = sorted(view.lens.focus for view in plan.views if view.split == split)
        for index, focus in enumerate(drawn):
            start = low + (high - low) * index / len(drawn)
            end = low + (high - low) * (index + 1) / len(drawn)
            assert start - FOUR_DECIMALS <= focus <= end + FOUR_DECIMALS
    assert {view.lens.aperture for view in plan.views} == {0.5}
