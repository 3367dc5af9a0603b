"""lenses.json, beside a scene's .ply: every view's learned lens, and the options needed to render as in training."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat, PositiveInt, ValidationError

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.lens import PhysicalLens

SCHEMA, VERSION = "dofbench.lenses", 1
_LENS = {
    "lens": "signed radius in pixels of the circle of confusion of what lies at z-depth z, in an image `width` pixels "
    "wide: aperture * (1 / z - focus_disparity); in proportion at other widths; negative is behind the focus",
    "aperture": "pixels * scene unit",
    "focus_disparity": "1 / scene unit; 0 is focus at infinity",
}
_FRAME = {"frame": "that of the cameras trained with; camera axes x right, y down, z forward"}


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


def write_lenses(
    path: Path,
    lenses: Mapping[str, PhysicalLens] | None,
    rendering: Mapping[str, int | float | bool | str],
    conventions: Mapping[str, str],
) -> None:
    """Write the lens of every view by name; None for a scene without lenses.

    rendering: the options that the scene is rendered with. conventions: the meaning of these options, in words.
    """
    write_json(
        path,
        {
            "schema_name": SCHEMA,
            "version": VERSION,
            "conventions": {**_LENS, **conventions, **_FRAME},
            "rendering": dict(rendering),
            "views": None if lenses is None else {name: vars(lens) for name, lens in lenses.items()},
        },
    )


def read_lenses(
    path: Path, known: Collection[str]
) -> tuple[dict[str, PhysicalLens] | None, dict[str, int | float | bool | str]]:
    """The lenses, None without, and the rendering options in the file, which must be among the `known` ones.

    Raises InputError when the file is missing, damaged, of another version, or has another option.
    """
    data = read_json(path)
    try:
        file = _File.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise InputError(path, f"{place}: {first['msg']}", f"lenses of version {VERSION} beside a .ply") from None
    unknown = sorted(set(file.rendering) - set(known))
    if unknown:
        raise InputError(path, f"rendering.{unknown[0]}", f"some of {', '.join(known)}")
    lenses = None
    if file.views is not None:
        lenses = {name: PhysicalLens(**view.model_dump()) for name, view in file.views.items()}
    return lenses, file.rendering
