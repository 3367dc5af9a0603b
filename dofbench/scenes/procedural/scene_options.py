"""The options of `make-scene`, and their checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dofbench.core.errors import InputError
from dofbench.core.number_lists import number_list, numbers
from dofbench.core.option_rules import EachFrom, Is, at_least, check, option

Variant = Literal["auto", "llvm_ad_rgb", "scalar_rgb"]
ALL = "all"
# Recipes on which anything may be tried, and recipes of scenes on which only frozen presets are run.
DEVELOPMENT = ("corridor", "fence", "foliage", "gloss", "macro", "meadow", "night", "tabletop", "tiles")
REPORT = ("attic", "firtree", "glaze", "moss", "spokes", "street")
NAMES = tuple(sorted((*DEVELOPMENT, *REPORT)))


@dataclass(frozen=True)
class MakeScene:
    """Render a procedural scene with ground truth: pinhole images, exact depth, photographs through a real thin
    lens."""

    recipe: Annotated[str, tyro.conf.Positional]
    """corridor, fence, foliage, gloss, macro, meadow, night, tabletop, tiles; or all of these. Of report scenes, whose
    seeds datasets/report.toml states: attic, firtree, glaze, moss, spokes, street."""

    out: Path | None = None
    """Folder to write; without it, data/scenes/RECIPE. With the recipe all: the folder that gets one folder per
    scene."""

    views: int = option(20, at_least(2))
    """Number of views."""

    width: int = option(320, at_least(8))
    """Image width, pixels."""

    height: int = option(240, at_least(8))
    """Image height, pixels."""

    path: Literal["forward", "orbit"] = "forward"
    """Camera path: side by side looking forward, or an arc around the middle of the scene."""

    samples: int = option(512, at_least(2))
    """Rays per pixel of the pinhole images."""

    lens_views: int = option(2, at_least(0))
    """How many of the views are photographed through the lenses; 0 for none."""

    lens_samples: int = option(4096, at_least(2))
    """Rays per pixel, each through its own lens point, of every photograph through a lens."""

    focus: Annotated[tuple[float, ...], number_list("--focus")] = option((0.2, 0.5, 0.8), EachFrom(0, 1))
    """Focus of the lenses, comma-separated: normalised disparity, 0 far to 1 near."""

    aperture: Annotated[tuple[float, ...], number_list("--aperture")] = option((0.5, 1.0), EachFrom(1e-3, 10))
    """Apertures of the lenses, comma-separated: 1 blurs by 2 % of the width per unit of disparity."""

    seed: int = option(0, at_least(0))
    """Seed of textures, props, camera path and the renderer's random numbers."""

    linear: Literal["exr-half", "exr-float"] = "exr-half"
    """Format of the images in linear light."""

    depth_bits: int = option(23, at_least(1), Is(lambda bits: bits <= 23, "at most 23"))
    """Bits of the depth's fraction that are kept; 23 is all of them, fewer make smaller files."""

    variant: Variant = "auto"
    """Mitsuba's variant, by name; auto: the vectorised one if a recent libLLVM is found, else the scalar one."""

    def __post_init__(self) -> None:
        if self.recipe not in (ALL, *NAMES):
            raise InputError("recipe", repr(self.recipe), f"{ALL} or one of {', '.join(NAMES)}")
        for name in ("focus", "aperture"):
            object.__setattr__(self, name, numbers(f"--{name}", getattr(self, name)))
        check(self)
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
