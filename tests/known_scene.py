"""A method that knows its scene, in place of one that has learned it."""

from __future__ import annotations

import numpy as np
from made_up import frontal

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import PhysicalLens
from dofbench.optics.defocus import defocus_numpy

WIDTH, HEIGHT = 96, 80
CAMERA = frontal(WIDTH, HEIGHT, 90.0)
TRUE = PhysicalLens(aperture=7.0, focus_disparity=0.35, width=WIDTH)  # circles up to 3.2 px


class Known:
    """A method that knows its scene: slanted stripes whose depth falls from left to right. lens: whether it has one."""

    def __init__(self, lens: bool = True, nan: bool = False, depth: bool = True):
        self._lens, self._nan, self._depth = lens, nan, depth
        self.rendered: list[int] = []

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        if lens is not None and not self._lens:
            raise ValueError("no lens here")
        self.rendered.append(camera.width)
        u, v = np.meshgrid(*camera.rays(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5))
        waves = [np.sin(40 * u + 9 * v + c) * np.cos(33 * v - (7 + 4 * c) * u) for c in range(3)]
        image = (0.5 + 0.4 * np.stack(waves, axis=2)).astype(np.float32)
        disparity = 0.2 + 0.6 * (u - u.min()) / (u.max() - u.min())
        depth = (1 / disparity).astype(np.float32)
        if lens is not None:
            image, _ = defocus_numpy(image, depth, lens)
        if self._nan:
            image[0, 0, 0] = np.nan
        return Rendering(image, depth if self._depth else np.zeros_like(depth))
