"""Opening a depth source by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dofbench.depth import DepthSource, SourceId
from dofbench.scenes.scene import Scene


def open_source(
    source: SourceId,
    scene: Scene,
    *,
    steps: int,
    seed: int,
    work: Path,
    network: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DepthSource:
    """Make the source ready for all views of the scene.

    steps, seed: of the reconstruction behind "splat"; network: the file behind "onnx"; work: a folder
    that keeps what takes long, so that it is made once; progress: called with (done, all) while it is
    made. Raises InputError when the scene lacks what the source needs.
    """
    if source == "splat":
        from dofbench.gaussians.splat_depth import SplatDepth

        return SplatDepth.make(scene, steps=steps, seed=seed, work=work, progress=progress)
    if source == "sfm":
        from dofbench.depth.sfm import SfmDepth

        return SfmDepth(scene)
    if source == "onnx":
        from dofbench.depth.onnx import OnnxDepth

        assert network is not None, "the source onnx needs a network"
        return OnnxDepth.make(scene, network=network, work=work, progress=progress)
    from dofbench.depth.given import GivenDepth

    return GivenDepth(scene, source)
