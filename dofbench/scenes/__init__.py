"""Scenes on disk, in any supported layout, as `Scene`. `load_scene` is the way in; `export` writes the layouts."""

from dofbench.scenes.loading import LAYOUTS, load_scene
from dofbench.scenes.scene import Scene, SceneView, Split

__all__ = ["LAYOUTS", "Scene", "SceneView", "Split", "load_scene"]
