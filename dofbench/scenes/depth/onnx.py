"""Depth by a monocular network given as ONNX, aligned to the sparse points view by view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import replacing
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.depth.align import ENOUGH, UNALIGNED, Alignment, fit, middle
from dofbench.scenes.depth.network import Network, network_digest, sampled, side_file
from dofbench.scenes.depth.sfm import spread_around
from dofbench.scenes.depth.sightings import CLIPPED, SceneSightings, Sightings, scene_sightings
from dofbench.scenes.depth.source import DepthEstimate, SourceId, clipped, trust
from dofbench.scenes.scene import Scene, SceneView

# Confidence of a view that was aligned by other views' points, and of one that nothing could be compared with.
_SHARED, _UNCOMPARED = 0.5, 0.5
# Without points: disparities below this share of the view's median are raised to it, and those above its inverse cut.
_OWN_FLOOR = 1e-3


class OnnxDepth:
    """The network's maps of all views, each with its alignment."""

    id: SourceId = "onnx"
    confidence = (
        "1 / (1 + (r / 5 % of the scene's disparity range)^2), r the root mean square residual of the sparse points "
        "around the pixel after alignment; half of that where a view had too few points of its own; 0.5 without points"
    )

    def __init__(
        self, network: Network, maps: Path, alignments: dict[str, Alignment], sightings: SceneSightings | None
    ):
        self._network, self._maps, self._alignments, self._sightings = network, maps, alignments, sightings

    @classmethod
    def make(
        cls,
        scene: Scene,
        *,
        network: Path,
        work: Path,
        progress: Callable[[int, int], None] | None = None,
        at_once: int = 1,
    ) -> OnnxDepth:
        """Run the network on every view, `at_once` views at a time, keep its maps in `work`, and align them. Raises
        InputError when the network can't be used, or the scene has no points to align to."""
        loaded = Network(network)
        free = loaded.description.align
        sightings = scene_sightings(scene, f"--depth onnx:{network.name}") if free != "none" else None
        maps = work / "network"

        def predict(view: SceneView) -> None:
            file = _map_file(maps, view.name)
            if not file.is_file():
                output = loaded.predict(view.image(), view.name)
                with replacing(file) as temporary:
                    np.save(temporary, output)

        for done, _ in enumerate(over_views(predict, scene.views, at_once), 1):
            if progress is not None:
                progress(done, len(scene.views))
        if sightings is None:
            return cls(loaded, maps, {view.name: UNALIGNED for view in scene.views}, None)
        pairs = {view.name: _pairs(maps, view, sightings.by_view[view.name]) for view in scene.views}
        return cls(loaded, maps, _aligned(pairs, loaded), sightings)

    def estimate(self, view: SceneView) -> DepthEstimate:
        """Depth at the view's size. Disparity beyond what the points' can mean is cut, and counted."""
        output = np.load(_map_file(self._maps, view.name))
        alignment = self._alignments[view.name]
        width, height = view.camera.width, view.camera.height
        meaning = self._network.description.output
        disparity = alignment.disparity(output, meaning)
        if self._sightings is not None:
            floor, ceiling = self._sightings.floor, self._sightings.ceiling
        else:
            middle = float(np.median(disparity))
            if not middle > 0:
                negative = f"a median disparity of {middle:g} for view {view.name}"
                cure = f"positive values, or another align than none in {side_file(self._network.file).name}"
                raise InputError(self._network.file, negative, cure)
            floor, ceiling = _OWN_FLOOR * middle, middle / _OWN_FLOOR
        disparity, outside = clipped(disparity, floor, ceiling)
        # Disparity is what is interpolated, not depth: blur is linear in it.
        depth = (1 / cv2.resize(disparity, (width, height), interpolation=cv2.INTER_LINEAR)).astype(np.float32)
        statistics = {"clipped": outside}
        if self._sightings is None:
            return DepthEstimate(depth, np.full(depth.shape, _UNCOMPARED, np.float32), statistics)
        sightings = self._sightings.by_view[view.name]
        confidence = np.full(depth.shape, _SHARED)
        if len(sightings):
            found = alignment.disparity(sampled(output, sightings.xy, width, height), meaning)
            relative = np.abs(np.clip(found, floor, ceiling) - sightings.disparity) / self._sightings.extent
            confidence = trust(spread_around(sightings, relative, depth.shape))
            confidence *= _SHARED if alignment.shared else 1.0
        statistics |= {
            "points": len(sightings),
            "inliers": alignment.inliers,
            "scale": alignment.scale,
            "shift": alignment.shift,
            "median_residual": alignment.residual / self._sightings.extent,
            "shared": float(alignment.shared),
        }
        return DepthEstimate(depth, confidence.astype(np.float32), statistics)

    def provenance(self) -> dict[str, Any]:
        """The network by content, its description, and what the numbers of each view mean."""
        file, description = self._network.file, self._network.description
        return {
            "from": "a monocular depth network, aligned to the sparse points"
            if self._sightings is not None
            else "a monocular depth network in scene units",
            "network": network_digest(file),
            "description": description.model_dump(mode="json", exclude_none=True),
            "scale, shift": f"of the network's output, which is {description.output}, to scene units; shared 1: found "
            f"from all views together, as this one saw fewer than {ENOUGH} points, or none that the network follows",
            "inliers": "share of the view's points within 2.5 standard deviations (by their median) after alignment",
            "median_residual": "of the points after alignment, as a share of the range of their disparities",
            "clipped": CLIPPED,
        }


def _map_file(maps: Path, view: str) -> Path:
    return maps / f"{view}.npy"


def _pairs(maps: Path, view: SceneView, sightings: Sightings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The network's output, the points' disparity, and the points' weight, where the view saw points: (M,) each."""
    output = np.load(_map_file(maps, view.name))
    at = sampled(output, sightings.xy, view.camera.width, view.camera.height) if len(sightings) else np.empty(0)
    return at, sightings.disparity, sightings.weight


def _aligned(pairs: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]], network: Network) -> dict[str, Alignment]:
    meaning, free = network.description.output, network.description.align
    own = {name: fit(*parts, meaning, free) for name, parts in pairs.items()}
    aligned = [found for found in own.values() if found is not None]
    if len(aligned) == len(own):
        return {name: found for name, found in own.items() if found is not None}
    everything = [np.concatenate(parts) for parts in zip(*pairs.values(), strict=True)]
    shared = fit(everything[0], everything[1], everything[2], meaning, free)
    if shared is None and 2 * len(aligned) >= len(own):
        # The network's scale differs so much between views that no common line fits all of them.
        shared = middle(aligned)
    if shared is None:
        expected = f"at least {ENOUGH} that it follows; is it {meaning}, as {side_file(network.file).name} says?"
        found = f"an output that does not follow the {len(everything[0])} sightings of sparse points"
        raise InputError(network.file, found, expected)
    return {name: found or replace(shared, shared=True) for name, found in own.items()}
