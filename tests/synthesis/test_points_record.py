"""Where points and poses come from, in plain words."""

from __future__ import annotations

import pytest

from dofbench.datasets.format.points_record import PointsRecord, points_in_words, points_of_plan

USUAL = {
    "origin": "structure from motion",
    "photographs": "sharp",
    "views": "all",
    "poses": "structure from motion on all views",
    "tracks": "known",
    "only_test_views": "left out",
    "count": 20,
    "given": 16,
}
BY_MOTION = "they come from structure from motion on the scene's photographs of all views, test views included."
LEFT_OUT = "Points that only test views saw aren't given to a method."
GIVEN = "Which views saw a point isn't known, so points that only test views saw are given to a method too."


@pytest.mark.parametrize(
    "changes, words",
    [
        (
            {},
            "Points and poses come from structure from motion on the sharp photographs of all views, test views "
            f"included, as is usual in the field; a user with shallow photographs has neither. {LEFT_OUT}",
        ),
        (
            {"photographs": "shallow", "tracks": "unknown", "only_test_views": "given"},
            "Points and poses come from structure from motion on the photographs of all views, test views included, as "
            f"is usual in the field. {GIVEN}",
        ),
        (
            {"origin": "rendered scene", "poses": "exact"},
            "Points are triangulated between the sharp images of all views, test views included, and poses are exact; "
            f"a user with shallow photographs has neither. {LEFT_OUT}",
        ),
        (
            {"origin": "triangulation", "photographs": "shallow", "views": "training"},
            "Points are triangulated between the shallow photographs of the training views alone; poses are given: "
            + BY_MOTION,
        ),
        (
            {"origin": "triangulation", "views": "training", "poses": "exact"},
            "Points are triangulated between the sharp photographs of the training views alone; poses are given: they "
            "are exact.",
        ),
        ({"origin": "none", "count": 0, "given": 0}, f"There are no points; poses are given: {BY_MOTION}"),
        (
            {"origin": "not stated", "photographs": "not stated", "views": "not stated", "poses": "not stated"}
            | {"tracks": "unknown", "only_test_views": "given"},
            f"The scene doesn't state where its points and poses come from. {GIVEN}",
        ),
    ],
)
def test_every_origin_has_its_words(changes: dict, words: str) -> None:
    record = PointsRecord(**USUAL | changes)
    assert points_in_words(record) == words
    assert points_of_plan({"points": record.model_dump(mode="json")}) == record


def test_an_older_dataset_or_result_states_nothing() -> None:
    assert points_of_plan({}) is None and points_of_plan({"points": None}) is None
    assert "not stated" in points_in_words(None)


def test_only_triangulated_points_are_a_protocol_of_their_own() -> None:
    assert PointsRecord(**USUAL).protocol == ""
    assert (
        PointsRecord(**USUAL | {"origin": "triangulation", "photographs": "shallow"}).protocol
        == "points from shallow training photographs"
    )
