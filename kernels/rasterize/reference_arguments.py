"""The arguments that `rasterize` takes, checked: the same for every compiled backend."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.raster import GEOMETRIES

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")


def check(
    parameters: tuple[Tensor, ...],
    filter_3d: Tensor | None,
    background: Tensor | None,
    blur: Tensor | None,
    radius: Tensor | None,
    geometry: str,
    sh_degree: int,
    filter_2d: float,
    near: float,
    kind: str,
) -> None:
    """Raise ValueError for arguments of the wrong shape, type, device or range; `cpu.rasterize` documents them. kind:
    of device, as torch names it."""
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
    shapes = ((n, 3), (n, 3), (n, 4), (n,), (n, 3), (n, rest, 3), (n,), (3,), (n,), (n,))
    names = (*NAMES, "filter_3d", "background", "blur", "radius")
    for name, value, shape in zip(names, (*parameters, filter_3d, background, blur, radius), shapes, strict=True):
        if value is None:
            continue
        if tuple(value.shape) != shape:
            raise ValueError(f"{name}: expected shape {shape}, found {tuple(value.shape)}")
        if value.dtype != torch.float32 or value.device.type != kind or not value.is_contiguous():
            found = f"{'' if value.is_contiguous() else 'not '}contiguous {value.dtype} on {value.device}"
            raise ValueError(f"{name}: expected contiguous torch.float32 on {kind}, found {found}")
        if name in ("filter_3d", "background") and value.requires_grad:
            raise ValueError(f"{name}: expected a tensor without gradient, found requires_grad=True")
