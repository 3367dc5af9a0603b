"""Making a dataset again from its manifest, and comparing the two byte for byte."""

from __future__ import annotations

import itertools
import shlex
from dataclasses import fields
from pathlib import Path
from typing import Any

from dofbench import __version__
from dofbench.core.errors import InputError
from dofbench.core.options import flag
from dofbench.core.progress import Progress
from dofbench.datasets.format.schema import MANIFEST, Manifest, read_manifest
from dofbench.datasets.synthesis.builder import make
from dofbench.datasets.synthesis.dataset_options import DatasetOptions, MakeDataset, MakeDatasets


def make_again(settings: MakeDatasets, progress: Progress) -> list[str]:
    """Make the dataset that the manifest `settings.like` describes; returns the names of the files that differ.

    Raises InputError when the scene isn't the one that the manifest is of, and for options that the manifest sets.
    """
    assert settings.like is not None
    like = settings.like if settings.like.is_dir() else settings.like.parent
    manifest = read_manifest(like)
    one = _settings(settings, manifest, like)
    if one.out is not None and one.out.resolve() == like.resolve():
        raise InputError("--out", f"{one.out}, the dataset that is to be made again", "another folder")
    if manifest.dofbench != __version__:
        raise InputError(
            like / MANIFEST, f"a dataset made by dofbench {manifest.dofbench}", f"one made by {__version__}"
        )
    out = make(one, progress, expected=manifest.source)
    again = read_manifest(out).files
    return sorted(name for name in again.keys() | manifest.files.keys() if again.get(name) != manifest.files.get(name))


def _settings(settings: MakeDatasets, manifest: Manifest, like: Path) -> MakeDataset:
    options: dict[str, Any] = {}
    for field in fields(DatasetOptions):
        given = getattr(settings, field.name)
        if field.metadata["about"] == "place":  # locations on this machine aren't in a manifest
            options[field.name] = given
            continue
        stored = manifest.settings.get(field.name, field.default)
        kind, _, place = str(stored).partition(":")
        if field.name == "depth" and place:
            if not given.startswith(f"{kind}:"):
                raise InputError("--depth", repr(given), f"{kind}:PATH, where the depth of {manifest.name} came from")
            options["depth"] = given
            continue
        if given != field.default:
            raise InputError("--like", f"{flag(field.name)} too", "no option that the manifest sets")
        options[field.name] = tuple(stored) if isinstance(stored, list) else stored
    if len(settings.scenes) > 1:
        raise InputError("--like", f"{len(settings.scenes)} scenes", "the one that the manifest is of")
    return MakeDataset(**options, scene=settings.scenes[0] if settings.scenes else _scene_of(manifest, like))


def _scene_of(manifest: Manifest, like: Path) -> str:
    """The scene in the manifest's command. Older versions wrote a name with a blank without quotes."""
    try:
        words = shlex.split(manifest.command)[2:]
    except ValueError:  # a quote that isn't closed
        words = []
    scene = " ".join(itertools.takewhile(lambda word: not word.startswith("--"), words))
    if not scene:
        raise InputError(like / MANIFEST, f"the command {manifest.command!r}", "one that names the scene")
    return scene
