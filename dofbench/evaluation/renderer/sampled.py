"""The renderer "thinlens": renders a make-scene scene again through a thin lens, with any number of rays."""

from __future__ import annotations

from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.lens import PhysicalLens
from dofbench.optics.tone import encode

if TYPE_CHECKING:
    from dofbench.scenes.procedural.tracer import Tracer


def has_geometry(scene: dict[str, Any]) -> bool:
    """Whether a scene.json names a recipe, and the program that can render it is installed."""
    named = isinstance(scene.get("recipe"), str) and isinstance(scene.get("seed"), int)
    return named and find_spec("mitsuba") is not None


def thin_lens(folder: Path, scene: dict[str, Any], view: str, lens: PhysicalLens, samples: int) -> np.ndarray:
    """(H, W, 3) float32, encoded: a view through `lens` with so many rays per pixel. Raises the errors of
    `Tracer.photograph`."""
    _choose_variant()
    # The random numbers differ from those of the scene's own photographs, with which this rendering is compared.
    shot = _tracer(scene["recipe"], scene["seed"]).photograph(
        _cameras(folder)[view], samples, f"validate/{scene['recipe']}/{view}", lens
    )
    return encode(np.clip(shot.linear, 0, 1))


@cache
def _choose_variant() -> None:
    from dofbench.scenes.procedural.variant import choose_variant

    choose_variant()


@lru_cache(maxsize=1)
def _tracer(recipe_name: str, seed: int) -> Tracer:
    from dofbench.scenes.procedural.recipes import recipe
    from dofbench.scenes.procedural.tracer import Tracer

    return Tracer(recipe(recipe_name).stage(seed))


@lru_cache(maxsize=1)
def _cameras(folder: Path) -> dict[str, Camera]:
    from dofbench.scenes.readers import nerfstudio

    return {view.name: view.camera for view in nerfstudio.read(folder, width=None, images=None, hold=None).views}
