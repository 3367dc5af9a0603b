"""The arguments of the rasterisers: checked, and in the form that the compiled stages need."""

from __future__ import annotations

import numpy as np
import torch

from dofbench.compute.raster import GEOMETRIES

from . import cpu_layout as layout

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
NOTHING = np.empty(0, np.float32)


def check(parameters, filter_3d, background, blur, geometry, sh_degree, filter_2d, near) -> None:
    """Raise ValueError for arguments of the wrong shape, type or range; `cpu.rasterize` documents them."""
    if not 0 <= sh_degree <= 3:
        raise ValueError(f"sh_degree: expected 0, 1, 2 or 3, found {sh_degree}")
    if not filter_2d >= 0:
        raise ValueError(f"filter_2d: expected at least 0, found {filter_2d}")
    if not near > 0:
        raise ValueError(f"near: expected more than 0, found {near}")
    if geometry not in GEOMETRIES:
        raise ValueError(f"geometry: expected one of {', '.join(GEOMETRIES)}, found {geometry!r}")
    n = parameters[0].shape[0] if parameters[0].ndim else 0
    rest = parameters[5].shape[1] if parameters[5].ndim == 3 and parameters[5].shape[1] in (0, 3, 8, 15) else "0|3|8|15"
    shapes = ((n, 3), (n, 3), (n, 4), (n,), (n, 3), (n, rest, 3), (n,), (3,), (n,))
    for name, value, shape in zip(
        (*NAMES, "filter_3d", "background", "blur"), (*parameters, filter_3d, background, blur), shapes, strict=True
    ):
        if value is None:
            continue
        if tuple(value.shape) != shape:
            raise ValueError(f"{name}: expected shape {shape}, found {tuple(value.shape)}")
        if value.dtype != torch.float32 or value.device.type != "cpu" or not value.is_contiguous():
            found = f"{'' if value.is_contiguous() else 'not '}contiguous {value.dtype} on {value.device}"
            raise ValueError(f"{name}: expected contiguous torch.float32 on cpu, found {found}")
        if name in ("filter_3d", "background") and value.requires_grad:
            raise ValueError(f"{name}: expected a tensor without gradient, found requires_grad=True")
    if blur is not None and n and (least := float(blur.detach().min())) < 0:
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
