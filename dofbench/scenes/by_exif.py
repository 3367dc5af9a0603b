"""The photographs of a scene that one aperture took to train on, and those of another to test with."""

from __future__ import annotations

import math
from dataclasses import replace

from dofbench.errors import InputError
from dofbench.scenes.types import Scene

SAME_F_NUMBER = 0.01  # relative; f-numbers are written down with two or three digits, and stops are 12 % apart


def split_by_f_number(scene: Scene, train: float, test: float) -> Scene:
    """The scene with its views of f-number `train` to train on and those of `test` to test with; the others are left
    out, with the points that none of the kept ones saw. Raises InputError where there is no view of either."""
    splits = {}
    for index, view in enumerate(scene.views):
        known = view.exif.f_number if view.exif is not None else None
        if known is not None and same_f_number(known, train):
            splits[index] = "train"
        elif known is not None and same_f_number(known, test):
            splits[index] = "test"
    for option, value, split in (("--train-f-number", train, "train"), ("--test-f-number", test, "test")):
        if split not in splits.values():
            raise InputError(option, f"no photograph at f/{value:g} in {scene.root}", f_numbers_in_words(scene))
    kept = list(splits)
    views = tuple(replace(scene.views[index], split=splits[index]) for index in kept)
    return replace(scene, views=views, points=None if scene.points is None else scene.points.seen_by(kept))


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
