"""The roles that named datasets state of their scenes: development, or report (`dofbench.core.evidence`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.evidence import Role
from dofbench.core.files import sha256_file
from dofbench.scenes.named.library import named_datasets, source_of
from dofbench.scenes.named.schema import NamedDataset, NamedScene


@dataclass(frozen=True)
class StatedRole:
    """A role, and the label (ID/SCENE; ID of a dataset whose scenes are found by looking) whose file states it."""

    role: Role
    by: str


def role_of_scene(library: Mapping[str, NamedDataset], dataset: NamedDataset, scene: NamedScene) -> StatedRole | None:
    """The role of a named scene, which may be `of` another dataset."""
    source, original = source_of(library, dataset, scene)
    role = source.role_of(original)
    return None if role is None else StatedRole(role, f"{source.id}/{original.name}")


def role_of_recipe(recipe: object, seed: object) -> StatedRole | None:
    """The role of a scene that make-scene rendered: of the scene with that recipe and seed, else of the dataset that
    stands for the recipe with any seed; None where no file names them."""
    library = named_datasets()
    for dataset, scene in _scenes(library):
        if scene.rendered is not None and (scene.rendered.recipe, scene.rendered.seed) == (recipe, seed):
            return role_of_scene(library, dataset, scene)
    for dataset in library.values():
        if recipe in dataset.recipes and dataset.role is not None:
            return StatedRole(dataset.role, dataset.id)
    return None


def role_by_files(folder: Path) -> StatedRole | None:
    """The role of the named scene whose files, as their checksums say, lie in the folder, wherever that is."""
    library = named_datasets()
    for dataset, scene in _scenes(library):
        files = scene.sha256.items()
        if files and all((folder / file).is_file() and sha256_file(folder / file) == one for file, one in files):
            return role_of_scene(library, dataset, scene)
    return None


def contradiction(role: Role | None, by: str) -> str:
    """What the named datasets' files say against a role that is recorded with its label; empty for nothing."""
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
