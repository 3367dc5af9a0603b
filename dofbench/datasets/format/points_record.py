"""Where the points and poses that a method gets come from: the record in dataset.json, and the same in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

Origin = Literal["structure from motion", "rendered scene", "triangulation", "not stated", "none"]
FoundIn = Literal["sharp", "shallow", "shallow and sharp", "not stated"]
FoundInViews = Literal["all", "training", "not stated"]
Poses = Literal["structure from motion on all views", "exact", "grid of a light field", "not stated"]
NOT_STATED: Final = "not stated"
_IMAGES = {"sharp": "all-in-focus images", "shallow": "shallow images"}


class PointsRecord(BaseModel):
    """Where the points and poses of a dataset come from, and what of them a method gets.

    origin: how the points were found; a scene that make-scene rendered has its points triangulated between its sharp
    images, by exact poses. photographs, views: what they were found in. poses: where the cameras' poses come from.
    tracks: whether it is known which views saw a point. only_test_views: what becomes of points that only test views
    saw; where tracks are unknown they can't be told apart, and are given. count: points of the dataset. given: those
    of them that a method gets. program: what triangulated the points, if this dataset's making did.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    origin: Origin
    photographs: FoundIn
    views: FoundInViews
    poses: Poses
    tracks: Literal["known", "unknown"]
    only_test_views: Literal["left out", "given"]
    count: int = Field(ge=0)
    given: int = Field(ge=0)
    program: str = ""

    @property
    def protocol(self) -> str:
        """The part of a protocol's name that says how points were found; "" for a scene's own points."""
        return f"points from {self.photographs} training photographs" if self.origin == "triangulation" else ""


def points_of_plan(plan: Mapping[str, Any]) -> PointsRecord | None:
    """Return the record in a run's plan; None in the plan of an older result."""
    points = plan.get("points")
    return None if points is None else PointsRecord.model_validate(points)


def points_in_words(record: PointsRecord | None) -> str:
    """Describe in one or two sentences the points that a method receives. None: an older dataset, without a record."""
    if record is None:
        return "The source of points and poses is unknown: this dataset was made before it was recorded."
    return " ".join(part for part in (_origin(record), _test_views(record)) if part)


def _origin(record: PointsRecord) -> str:
    if record.origin == "triangulation":
        return (
            f"Points are triangulated between the {_IMAGES.get(record.photographs, 'images')} of the training views "
            f"alone; poses are given: {_poses(record)}."
        )
    if record.origin == "rendered scene":
        return (
            "Points are triangulated between the all-in-focus images of all views, test views included, and poses are "
            "exact; a user with shallow photographs has neither."
        )
    if record.origin == "structure from motion":
        sharp = record.photographs == "sharp"
        return (
            f"Points and poses come from structure from motion on the {'all-in-focus ' if sharp else ''}images of all "
            "views, test views included, as is usual in the field"
            + ("; a user with shallow photographs has neither." if sharp else ".")
        )
    if record.origin == "none":
        return f"There are no points; poses are given: {_poses(record)}."
    return "The scene doesn't state where its points and poses come from."


def _poses(record: PointsRecord) -> str:
    if record.poses == "exact":
        return "they are exact"
    if record.poses == "grid of a light field":
        return "they come from the grid of a light field, calibrated by features of sharp views"
    if record.poses == NOT_STATED:
        return "the scene doesn't state where they come from"
    return "they come from structure from motion on the scene's images of all views, test views included"


def _test_views(record: PointsRecord) -> str:
    if record.origin == "none" or record.views == "training":
        return ""
    if record.only_test_views == "left out":
        return "Points that only test views saw aren't given to a method."
    return "Which views saw a point is unknown, so points that only test views saw are given to a method too."
