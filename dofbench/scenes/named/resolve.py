"""From what a user types to scenes: a folder, a built-in scene, a dataset, or one scene of it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.scenes.named.library import named_datasets
from dofbench.scenes.named.places import ResolvedScene, recognise, scenes_of, what_to_put
from dofbench.scenes.named.schema import NamedDataset

_CLOSE = 3


def resolve(text: str, data_root: Path | None) -> tuple[ResolvedScene, ...]:
    """The scenes of `text`: a folder, a built-in scene, the id of a dataset (all its scenes), ID/SCENE or SCENE.

    data_root: of named datasets. Absent scenes of a dataset have `missing` set. Raises InputError as `find_named` does,
    for an absent scene, and for a dataset of which every scene is absent (with what to put where).
    """
    if text and Path(text).is_dir():
        return (recognise(Path(text)),)
    if text and Path(text).is_file():
        raise InputError(text, "a file", "a scene folder; of a video, dofbench reconstruct VIDEO --out SCENE makes one")
    dataset, scenes = find_named(text, data_root)
    if all(scene.missing for scene in scenes):
        found = "no data root" if data_root is None else f"none of it in {data_root}"
        if dataset.built_in:
            found = "not part of this installation"
        whole = not scenes or (text == dataset.id and dataset.folders)
        raise InputError(text, found, what_to_put(dataset, dataset.folders, data_root) if whole else scenes[0].missing)
    return scenes


def find_named(text: str, data_root: Path | None) -> tuple[NamedDataset, tuple[ResolvedScene, ...]]:
    """The dataset and the scenes of `text`: ID of a dataset, ID/SCENE, or a scene's own name, SCENE.

    Absent scenes have `missing` set. Of several scenes of one name, those that are here count. Raises InputError for an
    unknown name (with close ones), and for a name of several scenes (with all of them).
    """
    library = named_datasets()
    dataset = library.get(text.partition("/")[0])
    if dataset is None:
        return _by_short_name(text, library, data_root)
    scenes = scenes_of(dataset, data_root)
    if text != dataset.id:
        scenes = tuple(scene for scene in scenes if scene.label == text)
        if not scenes and dataset.marker is None:
            raise _unknown(text, library)
    return dataset, scenes


def _by_short_name(
    text: str, library: Mapping[str, NamedDataset], data_root: Path | None
) -> tuple[NamedDataset, tuple[ResolvedScene, ...]]:
    named = []
    for dataset in library.values():
        # A scene's own name means the set that it comes from.
        borrowed = {f"{dataset.id}/{scene.name}" for scene in dataset.scenes if scene.of is not None}
        for scene in scenes_of(dataset, data_root):
            if scene.label.partition("/")[2] == text and text and scene.label not in borrowed:
                named.append((dataset, scene))
    chosen = [(dataset, scene) for dataset, scene in named if not scene.missing] or named
    if not chosen:
        raise _unknown(text, library)
    if len(chosen) > 1:
        raise InputError(text, "a name of several scenes", f"one of {', '.join(scene.label for _, scene in chosen)}")
    ((dataset, scene),) = chosen
    return dataset, (scene,)


def _unknown(text: str, library: Mapping[str, NamedDataset]) -> InputError:
    """The error for a text that means nothing, with the names that are spelt much the same."""
    names: dict[str, str] = {}
    for dataset in library.values():
        names[dataset.id] = dataset.id
        for scene in dataset.scenes:
            label = dataset.id if scene.name == dataset.id else f"{dataset.id}/{scene.name}"
            names[label] = label
            # A scene's own name means the set that it comes from.
            if scene.of is None:
                names.setdefault(scene.name, label)
    close = dict.fromkeys(names[name] for name in difflib.get_close_matches(text, names, n=_CLOSE))
    meant = f"a scene; did you mean {' or '.join(close)}?"
    expected = meant if close else f"a scene folder, or one of {', '.join(library)}"
    return InputError(text, "no such folder, built-in scene or named dataset", expected)
