"""The photographs of a scene that one aperture took to train on, and those of another to test with."""

from __future__ import annotations

import math
from dataclasses import replace

from dofbench.core.errors import InputError
from dofbench.scenes.scene import Scene, Split

SAME_F_NUMBER = 0.01  # relative; f-numbers are written down with two or three digits, and stops are 12 % apart


def split_by_f_number(scene: Scene, train: float, test: float, *, test_points: int = 0) -> Scene:
    """The scene with its views of f-number `train` to train on and those of `test` to test with; the others are left
    out, with the points that none of the kept ones saw.

    test_points: views to test with that share fewer points with those to train on are left out too, where tracks are
    known. Raises InputError where there is no view of either.
    """
    splits: dict[int, Split] = {}
    for index, view in enumerate(scene.views):
        known = view.exif.f_number if view.exif is not None else None
        if known is not None and same_f_number(known, train):
            splits[index] = "train"
        elif known is not None and same_f_number(known, test):
            splits[index] = "test"
    for option, value, split in (("--train-f-number", train, "train"), ("--test-f-number", test, "test")):
        if split not in splits.values():
            raise InputError(option, f"no photograph at f/{value:g} in {scene.root}", f_numbers_in_words(scene))
    splits = _covered(scene, splits, test_points)
    kept = list(splits)
    views = tuple(replace(scene.views[index], split=splits[index]) for index in kept)
    return replace(scene, views=views, points=None if scene.points is None else scene.points.seen_by(kept))


def _covered(scene: Scene, splits: dict[int, Split], least: int) -> dict[int, Split]:
    if scene.points is None or scene.points.views is None or least <= 0:
        return splits
    shared = dict.fromkeys(splits, 0)
    for track in scene.points.views:
        seen = [int(view) for view in track]
        if any(splits.get(view) == "train" for view in seen):
            for view in seen:
                if splits.get(view) == "test":
                    shared[view] += 1
    kept = {view: split for view, split in splits.items() if split == "train" or shared[view] >= least}
    if "test" not in kept.values():
        found = f"{max(count for view, count in shared.items() if splits[view] == 'test')} shared points at most"
        raise InputError("--test-points", found, f"a view to test with that shares at least {least}")
    return kept


def same_f_number(one: float, two: float) -> bool:
    """Whether two f-numbers are one, but for how they were rounded."""
    return math.isclose(one, two, rel_tol=SAME_F_NUMBER)


def f_numbers_in_words(scene: Scene) -> str:
    """As "one of f/5 (10 photographs), f/14 (28)"."""
    counts: dict[float, int] = {}
    for view in scene.views:
        if view.exif is not None and view.exif.f_number is not None:
            counts[view.exif.f_number] = counts.get(view.exif.f_number, 0) + 1
    if not counts:
        return "f-numbers in the photographs' EXIF, in an exif.csv or an exif.json beside them"
    return "one of " + ", ".join(f"f/{number:g} ({count})" for number, count in sorted(counts.items()))
