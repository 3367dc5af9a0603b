"""Schema of `datasets/ID.toml`."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    StringConstraints,
    model_validator,
)

from dofbench.core.evidence import Role

# Two are no layouts of scenes with poses: "lightfield", a grid of views, which make-dataset averages, and "blb", single
# views, which validate-renderer reads.
Layout = Literal["nerfstudio", "dofnerf", "llff", "deblurnerf", "colmap", "lightfield", "blb"]

NOT_STATED = "not stated"
# In a folder's name: the scene's name.
SCENE = "{scene}"

Text = Annotated[str, StringConstraints(min_length=1, strip_whitespace=True)]
Name = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_-]*$")]
Label = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_-]*/[a-z0-9][a-z0-9_-]*$")]
Checksum = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Hold = Annotated[int, Field(ge=2)]
_ROLES = " or ".join(f'role = "{role}"' for role in get_args(Role))


def _inside(folder: str) -> str:
    path = PurePosixPath(folder)
    if path.is_absolute() or ".." in path.parts or not path.parts:
        raise ValueError(f"{folder!r} leads out of the folder that it stands in")
    return folder


def _distinct(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(set(values)) < len(values):
        raise ValueError("every value once")
    return values


Folder = Annotated[str, AfterValidator(_inside)]
Grid = Annotated[tuple[Annotated[float, Field(ge=0, le=1)], ...], Field(min_length=1), AfterValidator(_distinct)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Recipe(_Record):
    """Defaults of make-dataset. focus: normalised disparity, 0 far to 1 near. aperture: 0 to 1. width: of the images,
    pixels; None keeps their own."""

    focus: Grid = (0.2, 0.5, 0.8)
    aperture: Grid = (0.5, 1.0)
    width: PositiveInt | None = None


class Rendered(_Record):
    """What identifies a scene of make-scene in its scene.json."""

    recipe: Name
    seed: NonNegativeInt


class Archive(_Record):
    """A zip file of scenes that `dofbench fetch` downloads.

    url: its address. stated_by: who gives address and checksum. sha256: as published; None where nobody publishes one.
    into: the folder below the data root that it is unpacked into; None for the data root. scenes: those in it; empty
    for all of the dataset.
    """

    url: Annotated[str, StringConstraints(pattern=r"^https?://[^/]+/.+")]
    stated_by: Text
    sha256: Checksum | None = None
    into: Folder | None = None
    scenes: tuple[Name, ...] = ()


class NamedScene(_Record):
    """One scene; its entries override its dataset's.

    role: permitted use (`dofbench.core.evidence`). of: `ID/SCENE` of another dataset with the same images; then it has
    no folders of its own. folders: below the data root, first choice first. hold: views 0, hold, 2 hold, ... are test
    views. images: folder of its images, as in `NamedDataset`. views: required number. size: width and height of the
    images read by default, pixels. sha256: of files that identify it. rendered: recipe and seed of a scene of
    make-scene. made_by: the command that makes it.
    """

    name: Name
    role: Role | None = None
    of: Label | None = None
    folders: tuple[Folder, ...] = ()
    hold: Hold | None = None
    images: Folder | None = None
    views: PositiveInt | None = None
    size: tuple[PositiveInt, PositiveInt] | None = None
    sha256: dict[Folder, Checksum] = {}
    rendered: Rendered | None = None
    made_by: Text | None = None
    note: Text | None = None


class LeftOut(_Record):
    """A scene excluded from a dataset, and why."""

    scene: Text
    why: Text


class NamedDataset(_Record):
    """datasets/ID.toml, named after `id`.

    licence: as its source states it, else "not stated". role: default of its scenes. built_in: its folders are next to
    the file, not below a data root. made_by: the command that makes it. layout: the reader of its scenes, except those
    `of` others. images: folder of images inside a scene, where it isn't the layout's own. folders: as
    `NamedScene.folders`, with {scene} for the scene's name. marker: every folder that fits `folders` and has this file
    or folder is a scene. expected: their number. recipes: of make-scene, with any seed that no scene names. archives:
    downloads with its scenes. by_hand: what to click, where there is none. notes: what was verified, and what wasn't.
    """

    id: Name
    title: Text
    origin: Text
    licence: Text
    terms: Text | None = None
    citation: tuple[Text, ...] = ()
    role: Role | None = None
    built_in: bool = False
    made_by: Text | None = None
    layout: Layout | None = None
    images: Folder | None = None
    hold: Hold | None = None
    folders: tuple[Folder, ...] = ()
    marker: Folder | None = None
    expected: PositiveInt | None = None
    recipes: tuple[Name, ...] = ()
    recipe: Recipe = Recipe()
    scenes: tuple[NamedScene, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    archives: tuple[Archive, ...] = ()
    by_hand: Text | None = None
    notes: Text | None = None

    @model_validator(mode="after")
    def _whole(self) -> NamedDataset:
        names = [scene.name for scene in self.scenes]
        if len(set(names)) < len(names):
            raise ValueError("two scenes of one name")
        if (self.marker is None) is (not names):
            raise ValueError("either scenes, or a marker by which they are found")
        if self.marker is not None and not any(SCENE in folder for folder in self.folders):
            raise ValueError(f"a marker needs folders with {SCENE}")
        if self.layout is None and not all(scene.of for scene in self.scenes):
            raise ValueError("no layout")
        if self.role is None and not self.scenes:
            raise ValueError(f"no role, expected {_ROLES}")
        for scene in self.scenes:
            if scene.of is None and self.role_of(scene) is None:
                raise ValueError(f"{scene.name} has no role, expected {_ROLES}, of the scene or of the dataset")
            places = bool(scene.folders or self.folders)
            if scene.of is None and not places:
                raise ValueError(f"{scene.name} has no folders")
            own = (scene.hold, scene.images, scene.views, scene.size, scene.sha256, scene.rendered, scene.made_by)
            if scene.of is not None and (places or any(own) or scene.role or self.role):
                raise ValueError(f"{scene.name} is {scene.of}, which says everything but its note")
        for archive in self.archives:
            if unknown := set(archive.scenes) - set(names):
                raise ValueError(f"an archive of {', '.join(sorted(unknown))}, which is no scene here")
        return self

    def role_of(self, scene: NamedScene) -> Role | None:
        """The scene's role; None for a scene that is `of` another dataset, which states it."""
        return scene.role or self.role

    def candidates(self, scene: NamedScene) -> tuple[str, ...]:
        """Where the scene may be, below the data root (built-in: beside the file), first choice first."""
        return tuple(folder.replace(SCENE, scene.name) for folder in (*scene.folders, *self.folders))
