"""The options of `dofbench refocus`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import NumberSequence, given, options, spelled


@options()
class Refocus:
    """Give one image a shallow depth of field, from its depth."""

    image: Annotated[Path, tyro.conf.Positional]
    """The image: PNG, JPEG, TIFF, EXR, HEIC, raw and others."""
    out: Path | None = None
    """Image to write, .png or .exr (linear light). Default: NAME-refocused.png in the current folder."""
    depth: str = "onnx:depthnet"
    """onnx:NETWORK.onnx with its description NETWORK.onnx.toml (docs/viewing.md), onnx:depthnet (built in, inaccurate),
    or a file of z-depth: EXR, 16-bit PNG, npy, COLMAP's .bin."""
    depth_unit: Annotated[float, Field(gt=0)] | None = None
    """Metres per unit of a depth file. Without it, its depth has no scale, and --f-number isn't possible."""
    at: NumberSequence[Annotated[float, Field(ge=0, le=1)]] = (0.5, 0.5)
    """X,Y of the point in focus, shares of width and height from the top left."""
    focus: float | None = None
    """Focus as normalised disparity of the image, 0 far to 1 near, in place of --at."""
    aperture: Annotated[float, Field(ge=0)] = 1.0
    """Aperture: 1 blurs by 2 % of the width per unit of normalised disparity, 0 not at all."""
    f_number: Annotated[float, Field(gt=0)] | None = None
    """F-number, in place of --aperture. Needs depth in metres, and the focal length by EXIF or --focal-length-35mm."""
    focal_length_35mm: Annotated[float, Field(gt=0)] | None = None
    """Focal length of the same angle of view on 36 x 24 mm, mm. Default: by EXIF."""
    sensor_diagonal: Annotated[float, Field(gt=0)] | None = None
    """Diagonal of the sensor that --f-number is meant for, mm. Default: the camera's own by EXIF, else 43.3."""
    blades: Annotated[int, Field(ge=0)] = 0
    """Blades of the aperture; 0 for a disc."""
    rotation: float = 0.0
    """Direction of the polygon's first corner, degrees from right towards down."""
    save_depth: Path | None = None
    """Write the normalised disparity that was used, as EXR."""

    def __post_init__(self) -> None:
        if self.blades in (1, 2):
            raise InputError("--blades", str(self.blades), "0 for a disc, or at least 3")
        if len(self.at) != 2:
            raise InputError("--at", spelled(self.at), "two numbers X,Y, shares of width and height")
        for one, other in (("focus", "at"), ("f_number", "aperture")):
            if getattr(self, one) is not None and given(self, other):
                raise InputError(f"--{other}", f"--{one.replace('_', '-')} too", "one of them")
        if self.out is not None and self.out.suffix.lower() not in (".png", ".exr"):
            raise InputError("--out", str(self.out), "a name that ends in .png or .exr")
