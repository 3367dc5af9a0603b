"""From photographs to verified matches: features, pairs, matches; the first half of every reconstruction."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.progress import Progress
from dofbench.runtime.threads import available_cores
from dofbench.scenes.reconstruction.features import FeatureCount, extract, register_images
from dofbench.scenes.reconstruction.focal_length import CameraGroup
from dofbench.scenes.reconstruction.interruptible import wait
from dofbench.scenes.reconstruction.matching import choose_pairs, match
from dofbench.scenes.reconstruction.pairs import Pair, choose
from dofbench.scenes.reconstruction.photograph_list import MASKS, Prepared
from dofbench.scenes.reconstruction.reconstruct_options import CameraModel, Matching


@dataclass(frozen=True)
class Compared:
    """What was done. features: of every photograph, by name. matching: how pairs were chosen. pairs: those compared, by
    index into the photographs."""

    features: dict[str, FeatureCount]
    matching: Matching
    pairs: list[Pair]


def compare(
    database: Path,
    folder: Path,
    photographs: Sequence[Prepared],
    groups: Sequence[CameraGroup],
    progress: Progress,
    *,
    matching: Matching,
    camera_model: CameraModel,
    most: int,
    seed: int,
    video: bool = False,
    error: float | None = None,
    timed: Callable[[str], AbstractContextManager[None]] = lambda stage: nullcontext(),
) -> Compared:
    """Find and match the features of `photographs`, which lie in `folder`, in `database`; what it has is kept.
    Nothing is taken from masked pixels.

    groups: the cameras; none where all poses are known. most: features of a photograph. error: pixels by which a match
    may miss the geometry of its two views; None for COLMAP's own. timed: measures the stages "features" and "matches".
    """
    with timed("features"), progress.stage("features", len(photographs)) as advance:
        register_images(database, folder, photographs, groups, camera_model)
        features = extract(
            database,
            folder,
            photographs,
            most=most,
            threads=_threads(),
            wait=wait,
            advance=advance,
            masks=folder.parent / MASKS,
        )
    mode = choose(matching, len(photographs), video)
    with timed("matches"):
        pairs = choose_pairs(mode, database, photographs, seed)
        with progress.stage("matches", len(pairs)) as advance:
            match(
                database,
                photographs,
                pairs,
                database.parent,
                seed=seed,
                wait=wait,
                advance=advance,
                error=error,
            )
    return Compared(features, mode, pairs)


def _threads() -> int:
    told = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return max(1, int(told)) if told.isdigit() else available_cores()
