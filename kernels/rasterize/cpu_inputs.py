"""The arguments of the rasterisers on the CPU: checked, and in the form that the compiled stages need."""

from __future__ import annotations

import numpy as np
import torch

from . import cpu_layout as layout
from .reference_arguments import NAMES
from .reference_arguments import check as check_arguments

NOTHING = np.empty(0, np.float32)


def check(parameters, filter_3d, background, blur, radius, geometry, sh_degree, filter_2d, near) -> None:
    """Raise ValueError for arguments of the wrong shape, type or range; `cpu.rasterize` documents them."""
    check_arguments(parameters, filter_3d, background, blur, radius, geometry, sh_degree, filter_2d, near, "cpu")
    if blur is not None and len(blur) and (least := float(blur.detach().min())) < 0:
        raise ValueError(f"blur: expected at least 0, found {least}")


class Settings:
    """The arguments that aren't differentiated, in the form that the kernels need."""

    def __init__(self, camera, degree, filter_2d, filter_2d_fades, near, geometry, filter_3d, background):
        self.degree, self.geometry = degree, geometry
        self.width, self.height = camera.width, camera.height
        self.columns = -(-camera.width // layout.TILE_WIDTH)
        self.rows = -(-camera.height // layout.TILE_HEIGHT)
        self.features = (0,) * geometry
        self.filter_3d = NOTHING if filter_3d is None else filter_3d.numpy()
        self.background = np.zeros(3, np.float32) if background is None else background.numpy()
        margin_x, margin_y = 0.15 * camera.width, 0.15 * camera.height
        self.view = view = np.zeros(layout.VIEW, np.float32)
        view[layout.ROTATION : layout.TRANSLATION] = camera.world_to_camera[:3, :3].ravel()
        view[layout.TRANSLATION : layout.CENTRE] = camera.world_to_camera[:3, 3]
        view[layout.CENTRE : layout.FX] = camera.centre
        view[layout.FX : layout.V_HIGH + 1] = (
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
            near,
            filter_2d,
            filter_2d_fades and filter_2d > 0,
            (-camera.cx - margin_x) / camera.fx,
            (camera.width - camera.cx + margin_x) / camera.fx,
            (-camera.cy - margin_y) / camera.fy,
            (camera.height - camera.cy + margin_y) / camera.fy,
        )


def describe(index: int, parameters, filter_3d, blur) -> str:
    """A message on which argument made Gaussian `index` non-finite."""
    for name, parameter in zip(NAMES, parameters, strict=True):
        row = parameter[index].detach()
        if not bool(torch.isfinite(row).all()):
            return f"{name}[{index}]: found {row.flatten().tolist()}, expected finite numbers"
    for name, values in (("filter_3d", filter_3d), ("blur", blur)):
        if values.size and not np.isfinite(values[index]):
            return f"{name}[{index}]: found {values[index]}, expected a finite number"
    return (
        f"Gaussian {index}: its projection overflows float32; mean {parameters[0][index].tolist()}, "
        f"log_scales {parameters[1][index].tolist()}"
    )
