"""The options of `make-scene`: what a user types, and what it means once checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dofbench.core.errors import InputError

Variant = Literal["auto", "llvm_ad_rgb", "scalar_rgb"]
ALL = "all"
NAMES = ("corridor", "fence", "foliage", "gloss", "macro", "meadow", "night", "tabletop", "tiles")


@dataclass(frozen=True)
class MakeScene:
    """Render a procedural scene whose truth is known: pinhole images, exact depth, images through a real thin lens."""

    recipe: Annotated[str, tyro.conf.Positional]
    """corridor, fence, foliage, gloss, macro, meadow, night, tabletop, tiles; or all of them."""

    out: Path | None = None
    """Folder to write; without it, data/scenes/RECIPE. With all: the folder that gets one folder a scene."""

    views: int = 20
    """Number of views."""

    width: int = 320
    """Image width, pixels."""

    height: int = 240
    """Image height, pixels."""

    path: Literal["forward", "orbit"] = "forward"
    """Cameras side by side that look forward, or on an arc around the middle of the scene."""

    samples: int = 512
    """Rays a pixel of the pinhole images."""

    lens_views: int = 2
    """How many of the views are photographed through the lenses; 0 for none."""

    lens_samples: int = 4096
    """Rays a pixel, and so lens points, of every photograph through a lens."""

    focus: str = "0.2,0.5,0.8"
    """Focus of the lenses, comma-separated: normalised disparity, 0 far to 1 near."""

    aperture: str = "0.5,1.0"
    """Apertures of the lenses, comma-separated: 1 blurs by 2 % of the width per unit of disparity."""

    seed: int = 0
    """Seed of textures, props, camera path and the renderer's random numbers."""

    linear: Literal["exr-half", "exr-float"] = "exr-half"
    """Format of the images in linear light."""

    depth_bits: int = 23
    """Bits kept of depth's fraction, 23 being all; fewer make smaller files."""

    variant: Variant = "auto"
    """Mitsuba's variant: the vectorised one where a recent libLLVM is found, else the scalar one, or one by name."""

    def __post_init__(self) -> None:
        if self.recipe not in (ALL, *NAMES):
            raise InputError("recipe", repr(self.recipe), f"{ALL} or one of {', '.join(NAMES)}")
        for option, value, lowest in (
            ("--views", self.views, 2),
            ("--width", self.width, 8),
            ("--height", self.height, 8),
            ("--samples", self.samples, 2),
            ("--lens-views", self.lens_views, 0),
            ("--lens-samples", self.lens_samples, 2),
            ("--seed", self.seed, 0),
            ("--depth-bits", self.depth_bits, 1),
        ):
            if value < lowest:
                raise InputError(option, str(value), f"at least {lowest}")
        if self.depth_bits > 23:
            raise InputError("--depth-bits", str(self.depth_bits), "at most 23")
        if self.lens_views > self.views:
            raise InputError("--lens-views", str(self.lens_views), f"at most the {self.views} views")
        _ = self.focus_values, self.aperture_values

    @property
    def recipes(self) -> tuple[str, ...]:
        """The recipes asked for."""
        return NAMES if self.recipe == ALL else (self.recipe,)

    @property
    def focus_values(self) -> tuple[float, ...]:
        """The focus values. Raises InputError for anything but distinct numbers in [0, 1]."""
        return _numbers("--focus", self.focus, 0.0, 1.0)

    @property
    def aperture_values(self) -> tuple[float, ...]:
        """The apertures. Raises InputError for anything but distinct positive numbers up to 10."""
        return _numbers("--aperture", self.aperture, 1e-3, 10.0)

    def folder(self, recipe: str) -> Path:
        """Where the scene of a recipe goes."""
        if self.out is None:
            return Path("data") / "scenes" / recipe
        return self.out / recipe if self.recipe == ALL else self.out


def _numbers(option: str, text: str, low: float, high: float) -> tuple[float, ...]:
    values = []
    for entry in text.split(","):
        try:
            value = float(entry)
        except ValueError:
            raise InputError(option, repr(text), "numbers separated by commas, such as 0.2,0.5") from None
        if not (math.isfinite(value) and low <= value <= high):
            raise InputError(option, entry.strip(), f"numbers from {low:g} to {high:g}")
        values.append(value)
    if len(set(values)) < len(values):
        raise InputError(option, repr(text), "every value once")
    return tuple(values)
