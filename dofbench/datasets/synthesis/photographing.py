"""`--renderer thinlens`: photographs through a real thin lens, for make-scene's scenes, whose geometry can be
rebuilt."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.datasets.format.schema import ThinLensRecord, ViewRecord
from dofbench.datasets.format.sensor import Sensor
from dofbench.optics.tone import encode

if TYPE_CHECKING:
    from dofbench.scenes.procedural.tracer import Photograph, Tracer


class Optics:
    """Renders photographs of a make-scene scene; `record` holds everything that the photographs depend on.

    The geometry is built when it is first needed. Raises InputError without mitsuba, and for an unknown recipe.
    """

    record_name = "thinlens"

    def __init__(self, recipe: str, seed: int, samples: int):
        from dofbench.scenes.procedural.recipes import recipe as find
        from dofbench.scenes.procedural.variant import choose_variant

        self._how = find(recipe)
        variant, self.remark = choose_variant()
        self.record = ThinLensRecord(
            recipe=recipe, seed=seed, samples=samples, mitsuba=version("mitsuba"), variant=variant
        )
        self._tracer: Tracer | None = None

    @classmethod
    def of_scene(cls, root: Path, samples: int) -> Optics:
        """The optics of a scene folder. Raises InputError when its scene.json names no recipe and seed."""
        from dofbench.scenes.procedural.scene_folder import read_record

        if not (root / "scene.json").is_file():
            raise InputError(root, "no scene.json, so no geometry", "a scene of make-scene's for --renderer thinlens")
        made = read_record(root)
        recipe, seed = made.get("recipe"), made.get("seed")
        if not (isinstance(recipe, str) and isinstance(seed, int)):
            raise InputError(root / "scene.json", f"recipe {recipe!r}, seed {seed!r}", "a recipe's name and a seed")
        return cls(recipe, seed, samples)

    def photograph(self, camera: Camera, view: ViewRecord, *, window: tuple[slice, slice] | None = None) -> Photograph:
        """The view through its lens. window: (rows, columns), to render only that part, with other random numbers.

        Raises InputError for a camera whose pixels aren't square or whose principal point is off the middle.
        """
        from dofbench.scenes.procedural.tracer import Tracer

        if self._tracer is None:
            self._tracer = Tracer(self._how.stage(self.record.seed))
        key = f"{self.record.recipe}/{self.record.seed}/{view.name}/{view.aperture!r}/{view.focus!r}"
        if window is not None:
            key += "/again"
        try:
            return self._tracer.photograph(camera, self.record.samples, key, view.physical(camera.width), window=window)
        except ValueError as error:
            raise InputError(f"view {view.name}", str(error), "a camera and a lens that mitsuba has") from None


def exposed(linear: np.ndarray, view: str, sensor: Sensor, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """(encoded, linear) as the sensor sees it: with its noise, if any; both (H, W, 3) float32, not clipped."""
    if sensor.is_noisy:
        linear = sensor.expose(linear, sensor.standard_noise(view, linear.shape))
    return encode(linear, gamma).astype(np.float32), linear.astype(np.float32)
