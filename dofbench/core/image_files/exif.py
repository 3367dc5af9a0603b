"""What a camera wrote down of a photograph: the part of EXIF that says something about its lens and its light.

A lens of focal length f at f-number N has an opening f / N wide, so between photographs of one focal length and one
sensor a learned aperture (pixels x scene unit) is in proportion to 1 / N: a truth about real photographs that needs no
rendered scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.core.names import inside

# No exposure, f-number, focal length or sensitivity is beyond these; products and squares stay finite within them.
LEAST, MOST = 1e-12, 1e12
EXIF_FILE = "exif.json"
_INFINITY = "inf"  # in files, as JSON has no such number


@dataclass(frozen=True)
class Exif:
    """One photograph's record; None is what nobody wrote down.

    f_number: focal length / diameter of the opening. focal_length: mm. focal_length_35mm: mm, of the lens with the
    same angle of view on 36 x 24 mm. focus_distance: m, as the camera estimated it; inf for infinity. exposure: s. iso:
    sensitivity. time: "YYYY-MM-DD hh:mm:ss", local to the camera. camera, lens: as the camera names them.
    """

    f_number: float | None = None
    focal_length: float | None = None
    focal_length_35mm: float | None = None
    focus_distance: float | None = None
    exposure: float | None = None
    iso: float | None = None
    time: str | None = None
    camera: str | None = None
    lens: str | None = None

    def __post_init__(self) -> None:
        for name in ("f_number", "focal_length", "focal_length_35mm", "focus_distance", "exposure", "iso"):
            value = getattr(self, name)
            infinite = name == "focus_distance" and value == math.inf
            if value is not None and not (LEAST <= value <= MOST or infinite):
                raise ValueError(f"{name}: expected a positive number, found {value!r:.60}")

    @property
    def light(self) -> float | None:
        """Light gathered, up to the camera's factor: exposure x iso / f_number^2; None unless all are known."""
        if self.exposure is None or self.iso is None or self.f_number is None:
            return None
        return self.exposure * self.iso / self.f_number**2

    def as_data(self) -> dict[str, Any]:
        """Plain data of what is known, of JSON's kinds: the text "inf" is infinity."""
        known = {name: value for name, value in asdict(self).items() if value is not None}
        return {name: _INFINITY if value == math.inf else value for name, value in known.items()}

    @staticmethod
    def of_data(data: Mapping[str, Any]) -> Exif:
        """What `as_data` gave. Raises ValueError for a name that isn't one or a value that can't be."""
        kinds = {field.name: str if field.name in ("time", "camera", "lens") else float for field in fields(Exif)}
        unknown = sorted(set(data) - set(kinds))
        if unknown:
            raise ValueError(f"{unknown[0]}: expected one of {', '.join(kinds)}")
        known: dict[str, Any] = {}
        for name, value in data.items():
            if name == "focus_distance" and value == _INFINITY:
                value = math.inf
            wanted = str if kinds[name] is str else int | float
            if isinstance(value, bool) or not isinstance(value, wanted):
                raise ValueError(f"{name}: expected {'text' if wanted is str else 'a number'}, found {value!r:.60}")
            known[name] = kinds[name](value)
        return Exif(**known)


def write_exif(folder: Path, of: Mapping[str, Exif]) -> None:
    """Write exif.json: view -> what is known of it."""
    write_json(folder / EXIF_FILE, {name: record.as_data() for name, record in sorted(of.items())})


def read_exif(folder: Path) -> dict[str, Exif]:
    """What `write_exif` wrote, by view; empty where there is no such file. Raises InputError for another content."""
    path = folder / EXIF_FILE
    if not path.is_file():
        return {}
    data, expected = read_json(path), "EXIF by view, as make-dataset writes it"
    if not isinstance(data, dict) or not all(isinstance(record, dict) for record in data.values()):
        raise InputError(path, "no object of objects", expected)
    try:
        return {inside(name, path): Exif.of_data(record) for name, record in data.items()}
    except InputError:
        raise
    except ValueError as error:
        raise InputError(path, str(error), expected) from None
