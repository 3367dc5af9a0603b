"""How a lens blurs, but for its aperture and focus: one value from the command line down to the scatter's call."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, GAMMA, LAYERS, ApertureShape, Defocus, Energy


@dataclass(frozen=True)
class Blur:
    """What all photographs by one lens have in common (docs/conventions.md, "Blur"; DoF-Gaussian, Eq. 6).

    gamma: of the display encoding, linear light is the encoded image to this power. alpha: hardness of the blur disc's
    edge, 1 / pixel. shape: of the aperture. energy: whether a pixel's weight is divided by its disc's area ("area") or
    as printed in the paper's Algorithm 1 ("algorithm1"). renderer: what blurs, "scatter" and "layered" from an image
    and its depth, "thinlens" from a scene's geometry, "light-field" from real views, by averaging them. layers: depth
    layers of "layered", which the others ignore.

    Raises InputError, whose subject is the field's name, for a value that doesn't exist.
    """

    gamma: float = GAMMA
    alpha: float = ALPHA
    shape: ApertureShape = ApertureShape()
    energy: Energy = "area"
    renderer: Defocus = "scatter"
    layers: int = LAYERS

    def __post_init__(self) -> None:
        for name in ("gamma", "alpha"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(name, str(value), "a positive number")
        for name, known in (("energy", get_args(Energy)), ("renderer", get_args(Defocus))):
            value = getattr(self, name)
            if value not in known:
                raise InputError(name, repr(value), f"one of {', '.join(known)}")
        if self.layers < 1:
            raise InputError("layers", str(self.layers), "at least 1")
