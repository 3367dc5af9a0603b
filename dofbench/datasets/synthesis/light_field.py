"""Photographs from a light field: averages of the real views in round windows of its grid.

A view of the dataset is a view of the grid. Its sharp image is the untouched view; its photograph is the average of the
views around it (`scenes/light_field/`), in a window whose radius is the planned aperture, shifted to the planned focus.
Test views are in no window of a training view.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, sha256_text
from dofbench.core.images import cropped
from dofbench.datasets.format.schema import LightFieldRecord, ViewRecord
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.lens_plan import Plan
from dofbench.datasets.synthesis.light_field_views import CROPPED, Chosen, check_grid, choose_views, with_defaults
from dofbench.scenes.depth.swept import SweptDepth
from dofbench.scenes.light_field.average import averaged
from dofbench.scenes.light_field.grid import LIGHT_FIELD, Grid, Place, read_grid
from dofbench.scenes.light_field.rig import Rig
from dofbench.scenes.light_field.window import reach_of, weights
from dofbench.scenes.named import ResolvedScene
from dofbench.scenes.scene import Scene, SceneView
from dofbench.scenes.views import DEFAULT_HOLD, split_rule


class LightField:
    """The views of a dataset on a light field's grid, and their photographs.

    scene: the views, all in focus, without points. settings: with the values that depend on the grid. disparity_range:
    of the grid's centre view, 1 / unit. depth: of all views. record: for lens.json. Raises InputError for a folder that
    is no light field, options that don't apply, and windows that the grid doesn't hold.
    """

    record_name = "light_field"

    def __init__(self, found: ResolvedScene, settings: MakeDataset):
        settings.check_light_field(found.label)
        grid = read_grid(found.root)
        check_grid(grid, settings)
        self._rig = Rig.of(grid)
        self.settings = replace(with_defaults(settings, self._rig), scene=found.label)
        chosen = choose_views(self._rig, self.settings)
        self._places, self._width, self._margin = chosen.places, chosen.width, chosen.margin
        self.scene = _scene(found, self._rig, chosen, self.settings)
        self._held_out = {self._places[view.name] for view in self.scene.test_views()}
        self.disparity_range = self._rig.disparity_range
        self.depth = SweptDepth(self._rig, self._places, self._width, self._margin)
        self.record = _record(self._rig, chosen)

    def check(self, plan: Plan) -> None:
        """Raise InputError for a planned view whose window has too few views."""
        cameras = {view.name: view.camera for view in self.scene.views}
        for view in plan.views:
            camera = cameras[view.name]
            lens = view.lens.physical(self.disparity_range, camera.width)
            if lens.aperture > 0:
                self._window(view.name, view.split == "train", lens.aperture / camera.fx)

    def photograph(self, camera: Camera, view: ViewRecord) -> np.ndarray:
        """The view through its lens, (H, W, 3) float32, linear light: the weighted mean of the views in its window,
        each shifted to its focus."""
        grid, place = self._rig.grid, self._places[view.name]
        window = self._window(view.name, view.split == "train", view.aperture_scene / camera.fx)
        parallax = self._rig.parallax_at(view.focus_scene)

        def by(other: Place) -> tuple[float, float]:
            down, right = self._rig.motion(place, other, self._width)
            return parallax * down, parallax * right

        views = ((grid.read(other, self._width), by(other), weight) for other, weight in window.items())
        return cropped(averaged(views, self.settings.gamma), self._margin).astype(np.float32)

    def _window(self, name: str, is_trained_on: bool, radius: float) -> dict[Place, float]:
        """Weights of the views in the window of a view. is_trained_on: whether test views are left out. Raises
        InputError for a window with too few views."""
        grid, (row, column) = self._rig.grid, self._places[name]
        reach = reach_of(radius / grid.step)
        around = {
            (down, right): (row + down, column + right) for down, right in product(range(-reach, reach + 1), repeat=2)
        }
        positions = {
            place: np.array(self._rig.motion((row, column), other, grid.size[0])) for place, other in around.items()
        }
        excluded = {place for place, other in around.items() if is_trained_on and other in self._held_out}
        found = weights(radius, grid.step, positions, excluded)
        if found is None:
            size = f"a window of {radius / grid.step:.2f} grid steps in radius"
            without = f", {len(excluded)} of whose views are test views" if excluded else ""
            room = "a larger --aperture" + (" or --spacing" if excluded else "") + ": too few views for a disc"
            raise InputError(f"--aperture of view {name}", size + without, room)
        return {around[place]: weight for place, weight in found.items()}


def _scene(found: ResolvedScene, rig: Rig, chosen: Chosen, settings: MakeDataset) -> Scene:
    grid = rig.grid
    views = tuple(
        SceneView(
            name=name,
            camera=rig.camera(place, chosen.width).cropped(chosen.margin),
            image=partial(_sharp, grid, place, chosen),
            source=grid.files[place],
        )
        for name, place in sorted(chosen.places.items())
    )
    scene = Scene(found.name, grid.root, LIGHT_FIELD, views, None).with_hold(settings.hold or DEFAULT_HOLD)
    notes = (
        f"{len(views)} of {len(grid.files)} views of the grid, every {settings.spacing} steps; others only in windows",
        f"cameras by {rig.calibration.matches} features matched between sharp views of the grid: median "
        f"{rig.calibration.epipolar_px:.2f} px from their epipolar lines",
        f"{chosen.margin} pixels are cropped at each border: {CROPPED}",
    )
    return replace(scene, split_by=split_rule(settings.hold, None, DEFAULT_HOLD)).noted(*notes)


def _record(rig: Rig, chosen: Chosen) -> LightFieldRecord:
    camera = rig.camera((0, 0), chosen.width)
    a, b, c, d = (float(value) for value in -rig.calibration.matrix.ravel())
    return LightFieldRecord(
        grid=sha256_text(canonical_json(rig.grid.checksums())),
        unit=rig.grid.unit,
        step=rig.grid.step,
        matrix=(a, b, c, d),
        matches=rig.calibration.matches,
        epipolar_px=round(rig.calibration.epipolar_px, 4),
        focal_px=camera.fx,
        infinity_px=rig.infinity * camera.fx / rig.focal,
        registered=rig.registered,
        margin_px=chosen.margin,
    )


def _sharp(grid: Grid, place: Place, chosen: Chosen) -> np.ndarray:
    return cropped(grid.read(place, chosen.width), chosen.margin)
