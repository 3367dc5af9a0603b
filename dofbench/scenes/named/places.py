"""Find the scenes of named datasets: below a data root, or next to the files that name them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, TypedDict, Unpack, cast

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.evidence import Role
from dofbench.core.files import read_json, sha256_file
from dofbench.scenes.loading import UNMARKED, load_scene
from dofbench.scenes.named.library import (
    StatedRole,
    named_datasets,
    role_by_files,
    role_of_recipe,
    role_of_scene,
    source_of,
)
from dofbench.scenes.named.schema import NOT_STATED, SCENE, NamedDataset, NamedScene, Recipe
from dofbench.scenes.readers.colmap_places import scene_folder
from dofbench.scenes.readers.folders import scene_name
from dofbench.scenes.scene import Alpha, Scene


class Reading(TypedDict, total=False):
    """The options of `load_scene`."""

    width: int | None
    images: str | None
    layout: str
    hold: int | None
    alpha_channel: Alpha | None
    skip_missing: bool


@dataclass(frozen=True)
class ResolvedScene:
    """A scene before it is read.

    label: the command line's name for it, or the folder's. name: default name of its dataset. root: its folder, or the
    first place to put it. dataset: id of its named dataset. layout, images, hold: as for `load_scene`. recipe: defaults
    of make-dataset. views, size, sha256: required, as in `NamedScene`. licence, terms, citation: of its source. role:
    permitted use (`dofbench.core.evidence`), None where not stated; role_by: the label whose file states it. missing:
    what to put where; empty where the scene is here.
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

    def reading(self, **asked: Unpack[Reading]) -> Reading:
        """All options for reading the scene; given ones win. The recipe's width counts without width and images."""
        own: dict[str, Any] = {"images": self.images, "layout": self.layout, "hold": self.hold}
        own |= {"width": self.recipe.width if asked.get("images") is None else None}
        given = {key: value for key, value in asked.items() if value is not None and (key, value) != ("layout", "auto")}
        return cast(Reading, {"alpha_channel": None, "skip_missing": False, **own, **given})

    def load(self, **asked: Unpack[Reading]) -> Scene:
        """Read the scene by `load_scene`, as `reading` says. Raises InputError as it does, or for a missing scene."""
        if self.missing:
            raise InputError(self.label, "no such scene here", self.missing)
        return replace(load_scene(self.root, **self.reading(**asked)), name=self.name)


VARIABLE = "DOFBENCH_DATA"
_RENDERED = "dofbench-scene"  # the schema of scene.json, as make-scene writes it


def find_data_root(given: Path | None = None) -> Path | None:
    """The folder with named datasets: `given`, else DOFBENCH_DATA's; None without both. Raises InputError where it is
    missing."""
    text = os.environ.get(VARIABLE, "")
    root = given if given is not None else Path(text).expanduser() if text else None
    if root is not None and not root.is_dir():
        subject = "--data-root" if given is not None else VARIABLE
        raise InputError(subject, f"{root}, which is no folder", "the folder that holds named datasets")
    return root


def scenes_of(dataset: NamedDataset, data_root: Path | None) -> tuple[ResolvedScene, ...]:
    """All scenes of a dataset, absent ones with `missing` set; for a dataset with a marker, those found."""
    if dataset.marker is not None:
        return tuple(_found(dataset, folder) for folder in _marked(dataset, data_root))
    return tuple(_known(named_datasets(), dataset, scene, data_root) for scene in dataset.scenes)


def what_to_put(
    dataset: NamedDataset, places: tuple[str, ...], data_root: Path | None, made_by: str | None = None
) -> str:
    """One line: the folders searched for, where, and their source. made_by: the command that makes them, None for the
    dataset's."""
    *others, last = places
    folders = f"{', '.join(others)} or {last}" if others else last
    where = f"in {data_root}" if data_root is not None else f"in the folder that --data-root or {VARIABLE} names"
    command = made_by or dataset.made_by
    source = f"made by `{command}`" if command else f"from {dataset.origin}"
    if dataset.archives:
        source += f", or by `dofbench fetch {dataset.id}`"
    return f"{folders.replace(SCENE, 'SCENE')} {where}; {source}"


def recognise(folder: Path) -> ResolvedScene:
    """The scene in a folder named by the user, or the folder of its COLMAP model.

    Where path and checksums are those of a named scene, origin, licence, citation and role are copied, and the layout
    where no file shows it. A rendered scene's record has them itself.
    """
    folder = scene_folder(folder)
    name = scene_name(folder)
    rendered = _rendered_facts(folder)
    if rendered is not None:
        return ResolvedScene(label=name, name=name, root=folder, **rendered)
    library = named_datasets()
    for dataset in library.values():
        for scene in dataset.scenes:
            if scene.of is None and not dataset.built_in and _is(folder, dataset, scene):
                untold = dataset.layout in UNMARKED
                return ResolvedScene(
                    label=name,
                    name=name,
                    root=folder,
                    dataset=dataset.id,
                    layout=str(dataset.layout) if untold else "auto",
                    hold=scene.hold or dataset.hold if untold else None,
                    licence=dataset.licence,
                    terms=dataset.terms or "",
                    citation=dataset.citation,
                    origin=dataset.origin,
                    note=scene.note or "",
                    **_role(role_of_scene(library, dataset, scene)),
                )
    # A copy under another name has at least the role of what it is a copy of.
    return ResolvedScene(label=name, name=name, root=folder, **_role(role_by_files(folder)))


def same_files(root: Path, sha256: Mapping[str, str]) -> str:
    """The first file that is missing or has another checksum; empty for none."""
    for file, expected in sha256.items():
        if not (root / file).is_file() or sha256_file(root / file) != expected:
            return file
    return ""


def _is(folder: Path, dataset: NamedDataset, scene: NamedScene) -> bool:
    parts = folder.resolve().parts
    tails = [PurePosixPath(place).parts for place in dataset.candidates(scene)]
    return any(parts[-len(tail) :] == tail for tail in tails) and not same_files(folder, scene.sha256)


def _known(
    library: Mapping[str, NamedDataset], dataset: NamedDataset, scene: NamedScene, data_root: Path | None
) -> ResolvedScene:
    source, original = source_of(library, dataset, scene)
    base = content_folder("datasets") if source.built_in else data_root
    places = source.candidates(original)
    found = [base / place for place in places if (base / place).is_dir()] if base is not None else []
    here = [folder for folder in found if _as_rendered(folder, original)]
    put = what_to_put(source, places, data_root, original.made_by)
    if source.built_in:
        put = f"`{original.made_by or source.made_by}`, which makes it"
    if found and not here:
        put = f"{found[0]} holds a scene of another recipe or seed; {put}"
    whole = scene.name == dataset.id
    return ResolvedScene(
        label=dataset.id if whole else f"{dataset.id}/{scene.name}",
        name=dataset.id if whole else f"{dataset.id}-{scene.name}",
        root=here[0] if here else (base or Path()) / places[0],
        dataset=dataset.id,
        # A built-in folder says its layout and its split itself.
        layout="auto" if source.built_in else str(source.layout),
        hold=None if source.built_in else original.hold or source.hold,
        images=original.images or source.images,
        recipe=Recipe(
            focus=dataset.recipe.focus,
            aperture=dataset.recipe.aperture,
            width=dataset.recipe.width or source.recipe.width,
        ),
        views=original.views,
        size=original.size,
        sha256=original.sha256,
        licence=source.licence,
        terms=source.terms or "",
        citation=tuple(dict.fromkeys((*dataset.citation, *source.citation))),
        origin=source.origin,
        note=scene.note or original.note or "",
        missing="" if here else put,
        **_role(role_of_scene(library, dataset, scene)),
    )


def _marked(dataset: NamedDataset, data_root: Path | None) -> list[Path]:
    """Folders with the dataset's marker; of two with the same name, the first choice."""
    if data_root is None or dataset.marker is None:
        return []
    found: dict[str, Path] = {}
    for place in dataset.folders:
        for folder in sorted(data_root.glob(place.replace(SCENE, "*"))):
            # Only a folder that names make-scene as its source is reported under this project's licence.
            ours = dataset.made_by is None or _rendered_facts(folder) is not None
            if (folder / dataset.marker).exists() and ours:
                found.setdefault(folder.name, folder)
    return [found[name] for name in sorted(found)]


def _found(dataset: NamedDataset, folder: Path) -> ResolvedScene:
    facts = {"licence": dataset.licence, "origin": dataset.origin, "citation": dataset.citation}
    if dataset.made_by is None and dataset.role is not None:  # else the folder's own record says recipe and seed
        facts |= _role(StatedRole(dataset.role, f"{dataset.id}/{folder.name}"))
    return ResolvedScene(
        label=f"{dataset.id}/{folder.name}",
        name=f"{dataset.id}-{folder.name}",
        root=folder,
        dataset=dataset.id,
        layout=str(dataset.layout),
        images=dataset.images,
        hold=dataset.hold,
        recipe=dataset.recipe,
        terms=dataset.terms or "",
        **(facts | (_rendered_facts(folder) or {})),
    )


def _rendered_facts(folder: Path) -> dict[str, Any] | None:
    """Licence, origin, citation and role of a folder that make-scene wrote; None for any other."""
    content = _scene_json(folder)
    if content is None:
        return None
    citation = content.get("citation") or ()
    return {
        "licence": str(content.get("licence") or NOT_STATED),
        "origin": str(content.get("origin") or ""),
        "citation": (citation,) if isinstance(citation, str) else tuple(map(str, citation)),
        **_role(role_of_recipe(content.get("recipe"), content.get("seed"))),
    }


def _scene_json(folder: Path) -> dict[str, Any] | None:
    file = folder / "scene.json"
    content = read_json(file) if file.is_file() else None
    return content if isinstance(content, dict) and content.get("schema") == _RENDERED else None


def _as_rendered(folder: Path, scene: NamedScene) -> bool:
    """Whether a folder has the scene's recipe and seed, if it has any."""
    if scene.rendered is None:
        return True
    content = _scene_json(folder) or {}
    return (content.get("recipe"), content.get("seed")) == (scene.rendered.recipe, scene.rendered.seed)


def _role(stated: StatedRole | None) -> dict[str, Any]:
    """The fields of `ResolvedScene` that say the role."""
    return {} if stated is None else {"role": stated.role, "role_by": stated.by}
