"""Reading `datasets/*.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pydantic import ValidationError

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.readable import read_toml
from dofbench.scenes.named.schema import NamedDataset, NamedScene


def named_datasets() -> Mapping[str, NamedDataset]:
    """The datasets that dofbench knows, by id, the built-in ones first."""
    return _library(content_folder("datasets"))


def read_dataset(path: Path) -> NamedDataset:
    """Read one file. Raises InputError, one line, for anything but a dataset called as its file."""
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
    """Read every file of a folder. Raises InputError also for a scene that is `of` one that isn't there."""
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
    """The dataset and scene whose files these are: themselves, or those that the scene is `of`."""
    if scene.of is None:
        return dataset, scene
    other, name = scene.of.split("/")
    return library[other], next(known for known in library[other].scenes if known.name == name)


@cache
def _library(folder: Path) -> dict[str, NamedDataset]:
    return read_library(folder)
