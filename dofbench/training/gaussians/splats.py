"""A scene's Gaussians as the .ply file that 3DGS writes and common splat viewers open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from dofbench.core.cameras import NO_OFFSET, Offset
from dofbench.core.errors import InputError
from dofbench.core.files import replacing
from dofbench.scenes.ply import read_comments, read_vertices
from dofbench.training.gaussians.model import Gaussians

EXPECTED = "a .ply file of Gaussians as 3DGS writes it"
_REST = 15  # coefficients per channel after the first, up to degree 3; some viewers require all of them
_PLACE, _COLOUR = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2")
_FORM = ("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
_ALWAYS = (*_PLACE, *_COLOUR, *_FORM)
_PROPERTIES = (*_PLACE, "nx", "ny", "nz", *_COLOUR, *(f"f_rest_{k}" for k in range(3 * _REST)), *_FORM)
# An opacity of exactly 0 or 1 has no finite logit; logits of this size give 0 or 1 within float32's precision.
_LARGEST_LOGIT = 30.0
_OFFSET = "offset"
_OFFSET_SAYS = "comment x y z are double precision: local coordinates plus this offset"


def write_splats(path: Path, gaussians: Gaussians, offset: Offset = NO_OFFSET) -> None:
    """Write N Gaussians as binary little-endian PLY of float32, atomically.

    Mip-Splatting's 3D filter is merged into scales and opacities, since viewers don't support it. Scales are natural
    logarithms of scene units, opacities logits, quaternions w first and of unit length; f_rest holds all of one
    channel's coefficients before the next one's, zero above the scene's degree; normals are zero. offset: added to the
    positions, which are then doubles (float32 rounds UTM coordinates to half a metre), and stated in the header.
    """
    parameters = {name: value.numpy(force=True) for name, value in gaussians.parameters.items()}
    log_scales, logits = (parameters[name].astype(np.float64) for name in ("log_scales", "opacity_logits"))
    if gaussians.filter_3d is not None:
        log_scales, logits = _baked(log_scales, logits, gaussians.filter_3d.double().numpy(force=True))
    count, terms = len(gaussians), parameters["sh_rest"].shape[1]
    rows = np.zeros((count, len(_PROPERTIES)), "<f4")  # columns in the order of _PROPERTIES
    rows[:, 0:3], rows[:, 6:9] = parameters["means"], parameters["sh_dc"]
    for channel in range(3):
        first = 9 + channel * _REST
        rows[:, first : first + terms] = parameters["sh_rest"][:, :, channel]
    rows[:, 54] = np.clip(logits, -_LARGEST_LOGIT, _LARGEST_LOGIT)
    rows[:, 55:58], rows[:, 58:62] = log_scales, _unit(parameters["quaternions"].astype(np.float64))
    body, kind, comments = rows.tobytes(), "float", []
    if offset != NO_OFFSET:
        placed = np.empty(count, [("place", "<f8", 3), ("others", "<f4", len(_PROPERTIES) - 3)])
        placed["place"], placed["others"] = parameters["means"].astype(np.float64) + np.array(offset), rows[:, 3:]
        body = placed.tobytes()
        kind, comments = "double", [f"comment {_OFFSET} {' '.join(map(repr, offset))}", _OFFSET_SAYS]
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            *comments,
            f"element vertex {count}",
            *(f"property {kind if name in _PLACE else 'float'} {name}" for name in _PROPERTIES),
            "end_header\n",
        ]
    )
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(header.encode("ascii"))
        stream.write(body)


def _baked(log_scales: np.ndarray, logits: np.ndarray, filter_3d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales and opacities with the 3D filter merged into them (Mip-Splatting, section 4.1)."""
    with np.errstate(divide="ignore"):
        log_filter = np.log(filter_3d)[:, None]
    filtered = 0.5 * np.logaddexp(2 * log_scales, 2 * log_filter)
    log_opacity = -np.logaddexp(0, -logits) + (log_scales - filtered).sum(axis=1)
    with np.errstate(divide="ignore"):
        return filtered, log_opacity - np.log(-np.expm1(log_opacity))


def _unit(quaternions: np.ndarray) -> np.ndarray:
    """The quaternions scaled to unit length; a zero quaternion becomes the identity rotation."""
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.where(length > 0, quaternions / np.where(length > 0, length, 1), [1.0, 0.0, 0.0, 0.0])


def read_offset(path: Path) -> Offset:
    """The offset in the header of a .ply of `write_splats`, or zero. Raises InputError for a damaged one."""
    for comment in read_comments(path, EXPECTED):
        match comment.split():
            case [word, *numbers] if word == _OFFSET:
                try:
                    x, y, z = (float(number) for number in numbers)
                except ValueError:
                    raise InputError(path, f"comment {comment}", "three numbers as the offset") from None
                if not np.isfinite([x, y, z]).all():
                    raise InputError(path, f"comment {comment}", "finite numbers")
                return x, y, z
    return NO_OFFSET


def read_splats(path: Path, offset: Offset | None = None) -> Gaussians:
    """Read Gaussians from 3DGS' PLY, binary or ASCII, with harmonics of degree 0 to 3, from any program.

    Other properties are ignored, except Mip-Splatting's filter_3D. offset: subtracted from the positions before they
    become float32; None for the header's. Raises InputError for a missing or damaged file or property.
    """
    offset = read_offset(path) if offset is None else offset
    rows = read_vertices(path, EXPECTED)
    names = set(rows.dtype.names or ())
    missing = [name for name in _ALWAYS if name not in names]
    if missing:
        raise InputError(path, f"no {', '.join(missing)}", EXPECTED)
    count = sum(name.startswith("f_rest_") for name in names)
    if count not in (0, 9, 24, 45) or any(f"f_rest_{k}" not in names for k in range(count)):
        raise InputError(path, f"{count} properties f_rest", "f_rest_0 to 8, 23 or 44, or none")

    def columns(*wanted: str) -> torch.Tensor:
        values = np.stack([rows[name] for name in wanted], axis=1) if wanted else np.empty((len(rows), 0))
        if wanted == _PLACE and offset != NO_OFFSET:
            values = values.astype(np.float64) - np.array(offset)
        if not np.isfinite(values).all():
            raise InputError(path, f"NaN or infinity in {wanted[0]} to {wanted[-1]}", "finite numbers")
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))

    rest = columns(*(f"f_rest_{k}" for k in range(count))).reshape(len(rows), 3, count // 3)
    return Gaussians(
        {
            "means": columns(*_PLACE),
            "log_scales": columns("scale_0", "scale_1", "scale_2"),
            "quaternions": columns("rot_0", "rot_1", "rot_2", "rot_3"),
            "opacity_logits": columns("opacity")[:, 0],
            "sh_dc": columns("f_dc_0", "f_dc_1", "f_dc_2"),
            "sh_rest": rest.transpose(1, 2),
        },
        columns("filter_3D")[:, 0].contiguous() if "filter_3D" in names else None,
    )


def lower_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """The Gaussians without the harmonics above `degree`."""
    terms = (min(degree, gaussians.max_sh_degree) + 1) ** 2 - 1
    return Gaussians(
        {**gaussians.parameters, "sh_rest": gaussians.parameters["sh_rest"][:, :terms]},
        gaussians.filter_3d,
        gaussians.near,
    )
