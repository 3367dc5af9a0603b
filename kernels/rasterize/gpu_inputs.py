"""The arguments of the rasterisers on a GPU, in the form that its kernels need."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera

from .reference_arguments import NAMES

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

    points: (P, 2) points of the lens, None for its centre alone. view: the numbers of the view and its points, on the
    device. views: how many pictures are drawn. columns, rows: of tiles in a picture.
    """

    def __init__(
        self,
        camera: Camera,
        degree: int,
        filter_2d: float,
        filter_2d_fades: bool,
        near: float,
        geometry: int,
        filter_3d: Tensor | None,
        background: Tensor | None,
        points: np.ndarray | None,
        device: torch.device,
    ) -> None:
        self.degree, self.geometry, self.fades = degree, geometry, bool(filter_2d_fades and filter_2d > 0)
        self.width, self.height = camera.width, camera.height
        self.columns, self.rows = -(-camera.width // TILE), -(-camera.height // TILE)
        self.moved = points is not None
        lens = np.zeros((1, 2), np.float32) if points is None else points
        self.views = len(lens)
        margin_x, margin_y = 0.15 * camera.width, 0.15 * camera.height
        view = np.zeros(POINTS + lens.size, np.float32)
        view[ROTATION:TRANSLATION] = camera.world_to_camera[:3, :3].ravel()
        view[TRANSLATION:CENTRE] = camera.world_to_camera[:3, 3]
        view[CENTRE:FX] = camera.centre
        view[FX : V_HIGH + 1] = (
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
            near,
            filter_2d,
            (-camera.cx - margin_x) / camera.fx,
            (camera.width - camera.cx + margin_x) / camera.fx,
            (-camera.cy - margin_y) / camera.fy,
            (camera.height - camera.cy + margin_y) / camera.fy,
        )
        view[POINTS:] = lens.ravel()
        # The driver takes a copy of so few numbers at once, so that nobody waits for the GPU.
        self.view = torch.from_numpy(view).to(device, non_blocking=True)
        self.filter_3d = filter_3d
        self.background = self.view[BLACK : BLACK + 3] if background is None else background


def explain(
    parameters: tuple[Tensor, ...], filter_3d: Tensor | None, blur: Tensor | None, radius: Tensor | None, index: int
) -> Exception:
    """The error that says why Gaussian `index` can't be drawn; waits for the GPU."""
    if blur is not None and float(blur[index]) < 0:
        return ValueError(f"blur: expected at least 0, found {float(blur[index])}")
    named = dict(zip((*NAMES, "filter_3d", "blur", "radius"), (*parameters, filter_3d, blur, radius), strict=True))
    for name, values in named.items():
        if values is not None and not bool(torch.isfinite(values[index]).all()):
            found = values[index].detach().flatten().tolist()
            if values.ndim == 1 and name not in NAMES:
                return FloatingPointError(f"{name}[{index}]: found {found[0]}, expected a finite number")
            return FloatingPointError(f"{name}[{index}]: found {found}, expected finite numbers")
    return FloatingPointError(
        f"Gaussian {index}: its projection overflows float32; mean {parameters[0][index].tolist()}, "
        f"log_scales {parameters[1][index].tolist()}"
    )
