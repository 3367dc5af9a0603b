"""The error of each depth source on scenes with exact depth: a table for reports/notes/depth.md.

    python benchmarks/depth_sources.py --work DIR [--scenes DIR ...] [--sources sfm,onnx,splat]

Truth is the scene's own exact depth. Reconstructions are stored in the work folder, so that a second run doesn't train
again.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.stats import spearmanr

from dofbench.core.content import content_folder
from dofbench.core.lens import COC_FRACTION
from dofbench.depth.disparity import scene_range
from dofbench.depth.estimate import DepthEstimate
from dofbench.depth.multi_view import consistencies, views_off
from dofbench.depth.network import find_network
from dofbench.depth.source import SourceId
from dofbench.scenes import load_scene
from dofbench.scenes.scene import Scene
from dofbench.synthesis.depth_sources import open_source

THINNED = 7  # one pixel in so many is used for rank correlation


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    work: Path
    """Folder for reconstructions and network maps."""
    scenes: tuple[Path, ...] = ()
    """Scenes with exact depth, in addition to the built-in one."""
    sources: str = "given,sfm,onnx,splat"
    """Sources, comma-separated."""
    steps: int = 3000
    """Training steps of splat."""


def main(settings: Settings) -> None:
    """Print one row per scene and source."""
    print(
        "| scene | source | AbsRel | within 1.25 | CoC error at A = 1, mean / median (px) | views differ by | "
        "views flagged | confidence: rank correlation | error, surest / least sure quarter (px) | s a view |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for folder in (content_folder("datasets") / "tabletop", *settings.scenes):
        scene = load_scene(folder)
        for source in settings.sources.split(","):
            _measure(scene, source, settings)


def _measure(scene: Scene, source_id: SourceId, settings: Settings) -> None:
    truth = []
    for view in scene.views:
        assert view.depth is not None, f"{view.source}: no exact depth"
        truth.append(view.depth())
    disparity_range = scene_range(lambda: iter(truth))
    start = time.process_time()
    source = open_source(
        source_id,
        scene,
        steps=settings.steps,
        seed=0,
        work=settings.work / scene.name,
        network=find_network("depthnet") if source_id == "onnx" else None,
    )
    estimates = [source.estimate(view) for view in scene.views]
    seconds = (time.process_time() - start) / len(estimates)
    agreement = consistencies(
        [view.name for view in scene.views],
        [view.camera for view in scene.views],
        lambda index: estimates[index].depth,
        scene.points,
        disparity_range,
    )
    pixels = COC_FRACTION * scene.views[0].camera.width / disparity_range.extent
    relative, near, blur, confidence = (
        np.concatenate(part)
        for part in zip(*(_errors(one, true, pixels) for one, true in zip(estimates, truth, strict=True)), strict=True)
    )
    order = np.argsort(confidence, kind="stable")
    least, most = (blur[part].mean() for part in (order[: len(order) // 4], order[-(len(order) // 4) :]))
    constant = bool(np.ptp(confidence) == 0)
    rank = "–" if constant else f"{spearmanr(confidence[::THINNED], -blur[::THINNED])[0]:.2f}"
    differs = [one.difference for one in agreement if one is not None]
    print(
        f"| {scene.name} | {source_id} | {relative.mean():.3f} | {near.mean():.3f} | {blur.mean():.3f} / "
        f"{np.median(blur):.3f} | {np.median(differs):.2%} | {len(views_off(agreement))} of {len(agreement)} | "
        f"{rank} | {'–' if constant else f'{most:.3f} / {least:.3f}'} | {seconds:.2f} |",
        flush=True,
    )


def _errors(
    estimate: DepthEstimate, truth: np.ndarray, pixels: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """For the pixels with a surface: relative error of depth, whether within 1.25, error in CoC pixels, confidence.

    Depth that the source doesn't know counts as infinitely far, as in the blur; its relative error counts as 1.
    """
    there = truth > 0
    true = 1 / truth[there].astype(np.float64)
    depth = estimate.depth[there].astype(np.float64)
    known = depth > 0
    found = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    relative = np.where(known, np.abs(depth * true - 1), 1.0)
    near = known & (np.maximum(depth * true, found / true) < 1.25)
    return relative, near, pixels * np.abs(found - true), estimate.confidence[there]


if __name__ == "__main__":
    main(tyro.cli(Settings))
