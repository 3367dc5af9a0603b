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


@pytest.mark.parametrize(
    "changes, words",
    [
        ({}, ["structure from motion on the all-in-focus images of all views", "only test views saw aren't given"]),
        (
            {"photographs": "shallow", "tracks": "unknown", "only_test_views": "given"},
            ["structure from motion on the images of all views", "only test views saw are given"],
        ),
        ({"origin": "rendered scene", "poses": "exact"}, ["triangulated between the all-in-focus images", "exact"]),
        (
            {"origin": "triangulation", "photographs": "shallow", "views": "training"},
            ["triangulated between the shallow images of the training views alone", "poses are given: they come from"],
        ),
        (
            {"origin": "triangulation", "photographs": "shallow and sharp", "views": "training", "poses": "exact"},
            ["triangulated between the images of the training views alone", "they are exact"],
        ),
        ({"origin": "none", "count": 0, "given": 0}, ["no points", "poses are given: they come from"]),
        (
            {"origin": "not stated", "photographs": "not stated", "views": "not stated", "poses": "not stated"}
            | {"tracks": "unknown", "only_test_views": "given"},
            ["doesn't state where its points and poses come from", "only test views saw are given"],
        ),
    ],
)
def test_every_origin_is_described(changes: dict, words: list[str]) -> None:
    record = PointsRecord(**USUAL | changes)
    text = points_in_words(record)
    assert all(part in text for part in words), text
    assert points_of_plan({"points": record.model_dump(mode="json")}) == record


def test_an_older_dataset_or_result_states_nothing() -> None:
    assert points_of_plan({}) is None and points_of_plan({"points": None}) is None
    assert "unknown" in points_in_words(None)


def test_only_triangulated_points_are_a_protocol_of_their_own() -> None:
    assert PointsRecord(**USUAL).protocol == ""
    assert (
        PointsRecord(**USUAL | {"origin": "triangulation", "photographs": "shallow"}).protocol
        == "points from shallow training photographs"
    )
