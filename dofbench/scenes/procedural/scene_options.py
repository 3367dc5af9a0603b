"""The options of `make-scene`, and their checks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field

from dofbench.core.errors import InputError, unknown
from dofbench.core.options import NumberList, options

Variant = Literal["auto", "llvm_ad_rgb", "scalar_rgb"]
ALL = "all"
# Recipes on which anything may be tried, and recipes of scenes on which only fixed presets are run.
DEVELOPMENT = ("corridor", "fence", "foliage", "gloss", "macro", "meadow", "night", "tabletop", "tiles")
REPORT = ("attic", "firtree", "glaze", "moss", "spokes", "street")
NAMES = tuple(sorted((*DEVELOPMENT, *REPORT)))


@options()
class MakeScene:
    """Render a procedural scene with ground truth: pinhole images, exact depth, photographs through a real thin
    lens."""

    recipe: Annotated[str, tyro.conf.Positional]
    """corridor, fence, foliage, gloss, macro, meadow, night, tabletop, tiles; or all of these. Of report scenes, whose
    seeds datasets/report.toml states: attic, firtree, glaze, moss, spokes, street."""

    out: Path | None = None
    """Folder to write; without it, data/scenes/RECIPE. With the recipe all: the folder that gets one folder per
    scene."""

    views: Annotated[int, Field(ge=2)] = 20
    """Number of views."""

    width: Annotated[int, Field(ge=8)] = 320
    """Image width, pixels."""

    height: Annotated[int, Field(ge=8)] = 240
    """Image height, pixels."""

    path: Literal["forward", "orbit"] = "forward"
    """Camera path: side by side looking forward, or an arc around the middle of the scene."""

    samples: Annotated[int, Field(ge=2)] = 512
    """Rays per pixel of the pinhole images."""

    lens_views: Annotated[int, Field(ge=0)] = 2
    """How many of the views are photographed through the lenses; 0 for none."""

    lens_samples: Annotated[int, Field(ge=2)] = 4096
    """Rays per pixel, each through its own lens point, of every photograph through a lens."""

    focus: NumberList[Annotated[float, Field(ge=0, le=1)]] = (0.2, 0.5, 0.8)
    """Focus of the lenses, comma-separated: normalised disparity, 0 far to 1 near."""

    aperture: NumberList[Annotated[float, Field(ge=1e-3, le=10)]] = (0.5, 1.0)
    """Apertures of the lenses, comma-separated: 1 blurs by 2 % of the width per unit of disparity."""

    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of textures, props, camera path and the renderer's random numbers."""

    linear: Literal["exr-half", "exr-float"] = "exr-half"
    """Format of the images in linear light."""

    depth_bits: Annotated[int, Field(ge=1, le=23)] = 23
    """Bits of the depth's fraction that are kept; 23 is all of them, fewer make smaller files."""

    variant: Variant = "auto"
    """Mitsuba's variant, by name; auto: the vectorised one if a recent libLLVM is found, else the scalar one."""

    def __post_init__(self) -> None:
        if self.recipe not in (ALL, *NAMES):
            raise unknown("recipe", self.recipe, (ALL, *NAMES))
        if self.lens_views > self.views:
            raise InputError("--lens-views", str(self.lens_views), f"at most the {self.views} views")

    @property
    def recipes(self) -> tuple[str, ...]:
        """The recipes asked for."""
        return DEVELOPMENT if self.recipe == ALL else (self.recipe,)

    def folder(self, recipe: str) -> Path:
        """The folder for the scene of a recipe."""
        if self.out is None:
            return Path("data") / "scenes" / recipe
        return self.out / recipe if self.recipe == ALL else self.out
