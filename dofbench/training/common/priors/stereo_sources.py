"""Which views a view is matched with: those that see many of its points from a suitable angle.

The work grows as the scene does: a view is compared with those that share most points with it, over these points alone.
"""

from __future__ import annotations

import numpy as np

from dofbench.core.contracts import TrainingSet

# Degrees between two views' rays: smaller angles are imprecise, at larger ones surfaces look different
ANGLE = (3.0, 12.0)
CANDIDATES = (
    64  # views that share most points with one, or without any the nearest: among these the best are looked for
)
SPREAD = 1024  # points over the whole scene, by which views without common points are compared
CLOUD = 16_384  # points of a cloud without tracks that count: each is seen by all views that it lies before
_UNSEEN = 1e-3  # of a suitable angle, for a view without common points: it comes after all others


def choose_sources(training_set: TrainingSet, most: int) -> list[list[int]]:
    """For each view up to `most` others to match it with, best first: with many common points at a suitable angle."""
    points, views = training_set.points, training_set.views
    assert points is not None
    centres = np.stack([view.camera.centre for view in views])
    if points.views is None:
        points = points.kept(np.arange(len(points)) % (-(-len(points) // CLOUD) or 1) == 0)
        seen = [np.flatnonzero(view.camera.inside(view.camera.project(points.xyz)[0])) for view in views]
    else:
        seen = [points.seen_from(index) for index in range(len(views))]
    rays = [_rays(points.xyz[index], centre) for index, centre in zip(seen, centres, strict=True)]
    spread = points.xyz[:: -(-len(points) // SPREAD) or 1]
    worth: list[dict[int, float]] = [{} for _ in views]
    place = np.full(len(points), -1)  # of each point among those that one view sees
    for one, others in enumerate(_sharing(seen, len(points))):
        place[seen[one]] = np.arange(len(seen[one]))
        for other in others:
            if other not in worth[one]:
                here = place[seen[other]]
                fair = _fairness(rays[one][here[here >= 0]], rays[other][here >= 0])
                worth[one][other] = worth[other][one] = float(fair.sum())
        place[seen[one]] = -1
    for one, known in enumerate(worth):
        if len(known) < min(most, len(views) - 1):
            own = _rays(spread, centres[one])
            nearest = np.argsort(np.linalg.norm(centres - centres[one], axis=1), kind="stable")
            for other in [int(view) for view in nearest if view != one and view not in known][:CANDIDATES]:
                known[other] = -1 + _UNSEEN * float(_fairness(own, _rays(spread, centres[other])).mean())
    return [[other for _, other in sorted((-value, other) for other, value in known.items())][:most] for known in worth]


def _sharing(seen: list[np.ndarray], points: int) -> list[list[int]]:
    """For each view up to CANDIDATES others with which it shares points, those with most first. seen: indices of each
    view's points."""
    from scipy.sparse import csr_array

    starts = np.cumsum([0, *map(len, seen)])
    sightings = csr_array((np.ones(starts[-1], np.int32), np.concatenate(seen), starts), shape=(len(seen), points))
    common = csr_array(sightings @ sightings.T)
    found = []
    for one in range(len(seen)):
        row = slice(common.indptr[one], common.indptr[one + 1])
        others, counts = common.indices[row], common.data[row]
        order = np.lexsort((others, -counts))
        found.append([int(other) for other in others[order] if other != one][:CANDIDATES])
    return found


def _rays(xyz: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(M, 3) unit vectors from a camera's centre to points (M, 3)."""
    rays = xyz - centre
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _fairness(rays: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(M,) 0 ... 1: how suitable the angles between rays (M, 3) of two views are for matching; 1 within ANGLE."""
    angle = np.degrees(np.arccos(np.clip((rays * others).sum(axis=1), -1, 1)))
    return np.minimum(angle / ANGLE[0], 1) ** 2 * np.minimum(ANGLE[1] / np.maximum(angle, 1e-9), 1) ** 2
