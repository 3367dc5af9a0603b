"""The arguments of the rasterisers on a GPU, in the form that its kernels need."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .op import View

TILE = 16  # pixels, width and height
RECORD = 16  # floats that projection keeps of a Gaussian
CHUNK = 64  # Gaussians of a tile's list that one program of blending's gradient goes through
KEPT = (4, 6, 9, 12)  # numbers that blending keeps of a pixel before each chunk, for each level of geometry
BAD = 2**31 - 1  # the number of tiles that stands for a Gaussian that can't be drawn, and so for an error

# Places in `Settings.view`, one float32 each: the camera, the constants of the view, three zeros that are the colour of
# a black background, and two for each point of the lens.
ROTATION, TRANSLATION, CENTRE = 0, 9, 12
FX, FY, CX, CY, WIDTH, HEIGHT, NEAR, FILTER_2D, U_LOW, U_HIGH, V_LOW, V_HIGH = range(15, 27)
BLACK, POINTS = 28, 32


class Settings:
    """The arguments that aren't differentiated, in the form that the kernels need.

    points: (P, 2) aperture samples, None for its centre alone. view: the numbers of the view and its points, on the
    device. views: how many images are drawn. columns, rows: of tiles in an image.
    """

    def __init__(self, view: View, points: np.ndarray | None, device: torch.device) -> None:
        self.degree, self.geometry, self.fades, self.filter_3d = view.degree, view.geometry, view.fades, view.filter_3d
        self.width, self.height = view.camera.width, view.camera.height
        self.columns, self.rows = -(-self.width // TILE), -(-self.height // TILE)
        self.moved = points is not None
        lens = np.zeros((1, 2), np.float32) if points is None else np.asarray(points, np.float32)
        self.views = len(lens)
        numbers = np.zeros(POINTS + lens.size, np.float32)
        numbers[: V_HIGH + 1] = view.constants()
        numbers[POINTS:] = lens.ravel()
        # The driver takes a copy of so few numbers at once, so that the host doesn't wait for the GPU.
        self.view = torch.from_numpy(numbers).to(device, non_blocking=True)
        self.background = self.view[BLACK : BLACK + 3] if view.background is None else view.background

    def given(self, *tensors: Tensor | None) -> list[Tensor]:
        """The tensors for a kernel that never reads those that are None."""
        return [self.view if tensor is None else tensor for tensor in tensors]
