"""Read `datasets/*.toml`: named datasets, their scenes, and the role of each scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import ValidationError

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.evidence import Role
from dofbench.core.files import sha256_file
from dofbench.core.readable import read_toml
from dofbench.scenes.named.schema import NamedDataset, NamedScene


def named_datasets() -> Mapping[str, NamedDataset]:
    """The named datasets by id, built-in ones first."""
    return _library(content_folder("datasets"))


def read_dataset(path: Path) -> NamedDataset:
    """Read one file. Raises InputError for anything but a dataset named like its file."""
    raw = read_toml(path, "a named dataset")
    try:
        dataset = NamedDataset.model_validate(raw)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, problem['loc'])) or 'file'}: {problem['msg']}" for problem in error.errors()
        )
        raise InputError(path, problems, "a named dataset (dofbench/scenes/named/schema.py)") from None
    if dataset.id != path.stem:
        raise InputError(path, f"id {dataset.id!r}", f"{path.stem!r}, as the file is called")
    return dataset


def read_library(folder: Path) -> dict[str, NamedDataset]:
    """Read every file of a folder. Raises InputError also for a scene `of` an unknown one."""
    read = [read_dataset(path) for path in sorted(folder.glob("*.toml"))]
    library = {dataset.id: dataset for dataset in sorted(read, key=lambda dataset: not dataset.built_in)}
    for dataset in read:
        for scene in dataset.scenes:
            if scene.of is not None:
                other, name = scene.of.split("/")
                source = library.get(other)
                known = [] if source is None else [known.name for known in source.scenes if known.of is None]
                if name not in known:
                    path = folder / f"{dataset.id}.toml"
                    raise InputError(path, f"{scene.name}, of {scene.of}", "of a scene with folders of its own")
    return library


def source_of(
    library: Mapping[str, NamedDataset], dataset: NamedDataset, scene: NamedScene
) -> tuple[NamedDataset, NamedScene]:
    """The dataset and scene with the files: themselves, or those that the scene is `of`."""
    if scene.of is None:
        return dataset, scene
    other, name = scene.of.split("/")
    return library[other], next(known for known in library[other].scenes if known.name == name)


@cache
def _library(folder: Path) -> dict[str, NamedDataset]:
    return read_library(folder)


@dataclass(frozen=True)
class StatedRole:
    """A role, and the label (ID/SCENE, or ID of a dataset with a marker) whose file states it."""

    role: Role
    by: str


def role_of_scene(library: Mapping[str, NamedDataset], dataset: NamedDataset, scene: NamedScene) -> StatedRole | None:
    """The role of a named scene, which may be `of` another dataset."""
    source, original = source_of(library, dataset, scene)
    role = source.role_of(original)
    return None if role is None else StatedRole(role, f"{source.id}/{original.name}")


def role_of_recipe(recipe: object, seed: object) -> StatedRole | None:
    """The role of a rendered scene: of the named scene with that recipe and seed, else of the dataset with that
    recipe; None without."""
    library = named_datasets()
    for dataset, scene in _scenes(library):
        if scene.rendered is not None and (scene.rendered.recipe, scene.rendered.seed) == (recipe, seed):
            return role_of_scene(library, dataset, scene)
    for dataset in library.values():
        if recipe in dataset.recipes and dataset.role is not None:
            return StatedRole(dataset.role, dataset.id)
    return None


def role_by_files(folder: Path) -> StatedRole | None:
    """The role of the named scene whose files, by their checksums, are in the folder."""
    library = named_datasets()
    for dataset, scene in _scenes(library):
        files = scene.sha256.items()
        if files and all((folder / file).is_file() and sha256_file(folder / file) == one for file, one in files):
            return role_of_scene(library, dataset, scene)
    return None


def contradiction(role: Role | None, by: str) -> str:
    """How the named datasets' files contradict a recorded role and label; empty if they don't."""
    if role is None:
        return f"role not stated, and yet by {by}" if by else ""
    library = named_datasets()
    name, _, scene_name = by.partition("/")
    dataset = library.get(name)
    if dataset is None:
        return f"role {role}, stated by {by or 'nothing'}, which is no named dataset"
    if not scene_name:
        stated = dataset.role
    else:
        scenes = [scene for scene in dataset.scenes if scene.name == scene_name]
        found = role_of_scene(library, dataset, scenes[0]) if scenes else None
        stated = dataset.role if not scenes and dataset.marker is not None else found.role if found else None
    if stated != role:
        return f"role {role}, and datasets/{name}.toml says {stated or 'nothing'} of {by}"
    return ""


def _scenes(library: Mapping[str, NamedDataset]) -> Iterator[tuple[NamedDataset, NamedScene]]:
    """Every dataset with each of its scenes that isn't `of` another one."""
    return ((dataset, scene) for dataset in library.values() for scene in dataset.scenes if scene.of is None)
