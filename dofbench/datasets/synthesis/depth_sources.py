"""Choosing and opening the depth source of a scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from dofbench.scenes.depth.source import DepthSource, SourceId
from dofbench.scenes.scene import Scene


def source_for(choice: Literal["auto"] | SourceId, scene: Scene) -> SourceId:
    """The source that `choice` means for the scene: "auto" is the given depth if every view has it, else splat.

    Raises InputError for "given" when a view has no depth.
    """
    if choice == "given":
        from dofbench.scenes.depth.given import require_depth

        require_depth(scene)
    if choice != "auto":
        return choice
    return "given" if all(view.depth is not None for view in scene.views) else "splat"


def open_source(
    source: SourceId,
    scene: Scene,
    *,
    steps: int,
    seed: int,
    work: Path,
    network: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    at_once: int = 1,
) -> DepthSource:
    """Prepare the source for all views of the scene.

    steps, seed: of the reconstruction for "splat"; network: the file for "onnx"; work: a folder that keeps slow
    results, so that they are computed once; progress: called with (done, total) meanwhile; at_once: views to work on at
    a time. Raises InputError when the scene lacks what the source needs.
    """
    if source == "splat":
        from dofbench.training.gaussians.scene_fit import SplatDepth

        return SplatDepth.make(scene, steps=steps, seed=seed, work=work, progress=progress, at_once=at_once)
    if source == "sfm":
        from dofbench.scenes.depth.sfm import SfmDepth

        return SfmDepth(scene)
    if source == "onnx":
        from dofbench.scenes.depth.onnx import OnnxDepth

        assert network is not None, "the source onnx needs a network"
        return OnnxDepth.make(scene, network=network, work=work, progress=progress, at_once=at_once)
    from dofbench.scenes.depth.given import GivenDepth

    return GivenDepth(scene, source)
