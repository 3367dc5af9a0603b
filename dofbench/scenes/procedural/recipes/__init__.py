"""The scenes that make-scene renders: one module per recipe, with its TITLE, its VIEWPOINTS and `stage(seed)`."""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

from dofbench.core.errors import unknown
from dofbench.scenes.procedural.scene_options import NAMES
from dofbench.scenes.procedural.stage import Stage, Viewpoints


class Recipe(Protocol):
    """A module of this package."""

    TITLE: str
    VIEWPOINTS: Viewpoints

    def stage(self, seed: int) -> Stage:
        """The whole scene; the same seed gives the same arrays."""


def recipe(name: str) -> Recipe:
    """The recipe of that name. Raises InputError when there is none."""
    if name not in NAMES:
        raise unknown("recipe", name, NAMES)
    return cast(Recipe, import_module(f"dofbench.scenes.procedural.recipes.{name}"))
