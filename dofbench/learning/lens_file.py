"""lenses.json, beside a scene's .ply: every view's learned lens, and what else it takes to render as in training."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat, PositiveInt, ValidationError

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.lens import PhysicalLens
from dofbench.learning.options import TrainerOptions

SCHEMA, VERSION = "dofbench.lenses", 1
# Trainer options that a trained scene is rendered with.
RENDERING = (
    "sh_degree",
    "background",
    "filter_2d",
    "lens",
    "lens_model",
    "lens_rings",
    "lens_blades",
    "lens_rotation",
    "lens_gamma",
    "lens_alpha",
    "lens_energy",
)
CONVENTIONS = {
    "lens": "signed radius in pixels of the circle of confusion of what lies at z-depth z, in an image `width` pixels "
    "wide: aperture * (1 / z - focus_disparity); in proportion at other widths; negative is behind the focus",
    "aperture": "pixels * scene unit",
    "focus_disparity": "1 / scene unit; 0 is focus at infinity",
    "blur": "of colours raised to lens_gamma; lens_model scatter: each pixel of the sharp image is spread evenly over "
    "its disc, or polygon of lens_blades sides, with a rim of softness 1 / lens_alpha, its weight divided by "
    "the area unless lens_energy is algorithm1; lens_model samples: the scene as seen from points of the lens",
    "filter_2d": "pixels^2, added to every footprint's covariance, opacity times sqrt(det before / det after)",
    "background": "grey level behind the scene, encoded like the colours",
    "frame": "that of the cameras trained with; camera axes x right, y down, z forward",
}


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    class View(BaseModel):
        model_config = ConfigDict(extra="forbid")
        aperture: FiniteFloat
        focus_disparity: FiniteFloat
        width: PositiveInt

    schema_name: Literal["dofbench.lenses"]
    version: Literal[1]
    conventions: dict[str, str]
    rendering: dict[str, int | float | bool | str]
    views: dict[str, View] | None


def write_lenses(path: Path, lenses: Mapping[str, PhysicalLens] | None, options: TrainerOptions) -> None:
    """Write the lens of every view by name, None for a scene without any, and the options it is rendered with."""
    write_json(
        path,
        {
            "schema_name": SCHEMA,
            "version": VERSION,
            "conventions": CONVENTIONS,
            "rendering": {name: getattr(options, name) for name in RENDERING},
            "views": None if lenses is None else {name: vars(lens) for name, lens in lenses.items()},
        },
    )


def read_lenses(path: Path, options: TrainerOptions) -> tuple[dict[str, PhysicalLens] | None, TrainerOptions]:
    """The lenses, and `options` with what the file says of rendering.

    Raises InputError when the file is missing, damaged or of another version.
    """
    data = read_json(path)
    try:
        file = _File.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise InputError(path, f"{place}: {first['msg']}", f"lenses of version {VERSION} beside a .ply") from None
    unknown = sorted(set(file.rendering) - set(RENDERING))
    if unknown:
        raise InputError(path, f"rendering.{unknown[0]}", f"some of {', '.join(RENDERING)}")
    lenses = None
    if file.views is not None:
        lenses = {name: PhysicalLens(**view.model_dump()) for name, view in file.views.items()}
    return lenses, options.with_overrides(file.rendering, f"{path}: rendering")
