"""A calibrated light field: the camera of every view, and depth by a plane sweep.

What a grid leaves free. Parallax is q = f / z + q_inf pixels per unit between views, so focal length f, depth z and the
parallax q_inf of what is infinitely far can't be told apart. Views that are registered on a plane have parallax of both
signs; then f is the image's width, and q_inf such that the farthest surface (percentile 1 of the centre view's
parallax) is twice as far away as the nearest (percentile 99). Parallax of one sign is taken for that of cameras with
fixed principal points, q_inf = 0. Another f scales all depths; another q_inf bends them by a projective map. Neither
changes a photograph, or an aperture and focus in normalised units.

Nor does parallax tell a scene from the same one turned inside out, seen from the opposite places: columns are taken to
be numbered as the camera moved to the right in its images. Rows may run up or down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.lens import DisparityRange
from dofbench.scenes.light_field.calibration import Calibration, calibrate
from dofbench.scenes.light_field.grid import Grid, Place
from dofbench.scenes.light_field.sweep import MARGIN, Neighbour, Swept, sweep

NEAR_FAR = 2.0  # depth of the farthest surface over that of the nearest, where it is free
# A sweep compares a view with those 2 and 4 steps away, by planes 0.04 pixels per step apart.
_AROUND, _STRIDE, _PLANES_APART = 4, 2, 0.04
_BEYOND = 0.1  # of the range of the features' parallax, by which a sweep goes beyond it on either side


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras of a grid's views, all with the axes of the centre view's image; positions and depth in `grid.unit`.

    calibration: with the sign by which a larger parallax is nearer. parallax: percentiles 1 and 99 of the centre
    view's; infinity: q_inf; all in pixels of the grid's own size per unit. registered: whether the principal points
    move with the views.
    """

    grid: Grid
    calibration: Calibration
    parallax: tuple[float, float]
    infinity: float
    registered: bool

    @staticmethod
    def of(grid: Grid) -> Rig:
        """Calibrate the grid and sweep its centre view. Raises InputError as `calibrate` does, and for an unreadable
        image."""
        found = calibrate(grid)
        right = (found.matrix @ (grid.positions[0, 1] - grid.positions[0, 0]))[1]
        if right > 0:  # then nearer points, which the camera's way to the right moves to the left, have the smaller q
            low, high = found.disparities
            found = replace(found, matrix=-found.matrix, disparities=(-high, -low))
        rig = Rig(grid, found, found.disparities, 0.0, True)
        far, near = (float(end) for end in np.percentile(rig.swept((0, 0), grid.size[0]).disparity, (1.0, 99.0)))
        if far > 0:
            return replace(rig, parallax=(far, near), registered=False)
        return replace(rig, parallax=(far, near), infinity=(NEAR_FAR * far - near) / (NEAR_FAR - 1))

    @property
    def focal(self) -> float:
        """Focal length by convention, pixels of the grid's own size."""
        return float(self.grid.size[0])

    @property
    def disparity_range(self) -> DisparityRange:
        """The scene's, 1 / unit: of the centre view."""
        return DisparityRange(*((end - self.infinity) / self.focal for end in self.parallax))

    def camera(self, place: Place, width: int) -> Camera:
        """The view's camera, for an image `width` pixels wide."""
        full_width, full_height = self.grid.size
        down, right = -self.calibration.matrix @ self.grid.positions[place]
        pose = np.eye(4)
        pose[:2, 3] = -right, -down
        cx, cy = full_width / 2 - self.infinity * right, full_height / 2 - self.infinity * down
        camera = Camera(full_width, full_height, self.focal, self.focal, cx, cy, pose)
        return camera.resized(width, self.grid.height_at(width))

    def motion(self, start: Place, end: Place, width: int) -> tuple[float, float]:
        """(down, right) by which a point of parallax 1 moves between two views, pixels of images of this width."""
        full_width, full_height = self.grid.size
        scale = self.grid.height_at(width) / full_height, width / full_width
        down, right = self.calibration.matrix @ (self.grid.positions[end] - self.grid.positions[start]) * scale
        return float(down), float(right)

    def swept(self, place: Place, width: int) -> Swept:
        """Parallax of the view at this width, by a sweep over the views around it."""
        low, high = self.calibration.disparities
        step = self.grid.step * width / self.grid.size[0]  # units of the grid to pixels per step
        beyond = MARGIN / step + _BEYOND * (high - low)
        around = [
            (place[0] + down, place[1] + right)
            for down, right in product(range(-_AROUND, _AROUND + 1, _STRIDE), repeat=2)
            if (down, right) != (0, 0) and (place[0] + down, place[1] + right) in self.grid.files
        ]
        view, neighbours = self.grid.read(place, width), self._neighbours(place, around, width)
        return sweep(view, neighbours, low - beyond, high + beyond, _PLANES_APART / step)

    def parallax_at(self, depth: float) -> float:
        """Parallax at a depth, in the grid's unit."""
        return self.infinity + self.focal / depth

    def depth(self, parallax: np.ndarray) -> np.ndarray:
        """z-depth (H, W) float32, in the grid's unit, of a view's parallax; 0 where it is beyond infinity."""
        with np.errstate(divide="ignore"):
            depth = self.focal / (parallax - self.infinity)
        return np.where(parallax > self.infinity, depth, 0.0).astype(np.float32)

    def _neighbours(self, place: Place, others: list[Place], width: int) -> list[Neighbour]:
        return [
            Neighbour(
                self.grid.read(other, width),
                (other[0] - place[0], other[1] - place[1]),
                self.motion(place, other, width),
            )
            for other in others
        ]
