"""A scene that was asked for: where it is, how to read it, whose it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypedDict

from dofbench.core.errors import InputError
from dofbench.core.evidence import Role
from dofbench.scenes.loading import load_scene
from dofbench.scenes.named.schema import NOT_STATED, Recipe
from dofbench.scenes.scene import Alpha, Scene


class Reading(TypedDict):
    """The options of `load_scene`."""

    width: int | None
    images: str | None
    layout: str
    hold: int | None
    alpha_channel: Alpha | None
    skip_missing: bool


@dataclass(frozen=True)
class ResolvedScene:
    """A scene, and what is known of it before it is read.

    label: what to type for it, or the folder's name; nothing of this machine is in it. name: what its dataset is called
    by default. root: its folder; where it is missing, the first place to put it. dataset: id of the named dataset, None
    for a folder that belongs to none. layout, images, hold: as `load_scene` takes them. recipe: what make-dataset takes
    where the user doesn't say. views, size, sha256: what must be found, as `NamedScene`. licence: "not stated" where
    its source doesn't; terms: more about that. citation: one reference each. note: what a user should know. role: what
    the scene may be used for (`dofbench.core.evidence`), None where no file states it; role_by: the label whose file
    states it. missing: one line that says what to put where; empty where the scene is here.
    """

    label: str
    name: str
    root: Path
    dataset: str | None = None
    layout: str = "auto"
    images: str | None = None
    hold: int | None = None
    recipe: Recipe = Recipe()
    views: int | None = None
    size: tuple[int, int] | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)
    licence: str = NOT_STATED
    terms: str = ""
    citation: tuple[str, ...] = ()
    origin: str = ""
    note: str = ""
    role: Role | None = None
    role_by: str = ""
    missing: str = ""

    def reading(
        self,
        *,
        width: int | None = None,
        images: str | None = None,
        layout: str = "auto",
        hold: int | None = None,
        alpha_channel: Alpha | None = None,
        skip_missing: bool = False,
    ) -> Reading:
        """How the scene is to be read: options that are given go before what is known of it.

        The recipe's width counts where neither a width nor a folder of images is given.
        """
        return Reading(
            width=self.recipe.width if width is None and images is None else width,
            images=self.images if images is None else images,
            layout=self.layout if layout == "auto" else layout,
            hold=self.hold if hold is None else hold,
            alpha_channel=alpha_channel,
            skip_missing=skip_missing,
        )

    def load(
        self,
        *,
        width: int | None = None,
        images: str | None = None,
        layout: str = "auto",
        hold: int | None = None,
        alpha_channel: Alpha | None = None,
        skip_missing: bool = False,
    ) -> Scene:
        """Read the scene by `load_scene`, as `reading` says. Raises InputError as it does, or for a missing scene."""
        if self.missing:
            raise InputError(self.label, "no such scene here", self.missing)
        asked = Reading(
            width=width,
            images=images,
            layout=layout,
            hold=hold,
            alpha_channel=alpha_channel,
            skip_missing=skip_missing,
        )
        scene = load_scene(self.root, **self.reading(**asked))
        return replace(scene, name=self.name)
