"""Copies files from a finished dataset of the same scene: sharp images and depth from one with another lens, and the
photographs too from one that differs in its points alone."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.files import replacing, sha256_file, write_json
from dofbench.datasets.format import layout
from dofbench.datasets.format.points_choice import Points
from dofbench.datasets.format.schema import (
    LENS_FILE,
    MANIFEST,
    LensFile,
    Manifest,
    SourceRecord,
    read_lens_file,
    read_manifest,
)
from dofbench.datasets.synthesis.dataset_options import DatasetOptions, MakeDataset
from dofbench.datasets.synthesis.work import DEPTH_RECORD, NOISE, WORK, noise_file

_TRUTH = (layout.sharp_path, layout.depth_path, layout.confidence_path)


def take_over(sibling: Path, out: Path, source: SourceRecord, settings: MakeDataset) -> None:
    """Copy files missing in `out` from the dataset `sibling`, if it is complete and its sharp images and depth were
    made in the same way."""
    if not (sibling / MANIFEST).is_file():
        return
    manifest = read_manifest(sibling)
    same = (manifest.source.geometry, manifest.source.images) == (source.geometry, source.images)
    recipe = settings.recipe()
    # The sharp images of a scene of linear light are encoded here, and stored as light besides.
    made_here = ("gamma", "linear") if any(image.linear for image in source.images) else ()
    sharp = [at.name for at in fields(DatasetOptions) if at.metadata.get("sharp") or at.name in made_here]
    if not same or any(manifest.settings.get(name) != recipe.get(name) for name in sharp):
        return
    _copy(sibling, manifest, out, (*_TRUTH, layout.sharp_linear_path))


def take_over_all(other: Path, out: Path, identity: Callable[[Points], str]) -> None:
    """Copy files missing in `out` from the dataset `other`, which differs in its points alone.

    identity: of the dataset that is being made, if its points were of the given kind. Raises InputError where `other`
    is no dataset or differs in anything else.
    """
    manifest = read_manifest(other)
    points: Points = manifest.settings.get("points", "scene")
    if manifest.identity != identity(points):
        raise InputError(
            "--reuse", f"{other}, of another scene, split, version or lens", "a dataset that differs in --points alone"
        )
    _copy(other, manifest, out, (*_TRUTH, layout.sharp_linear_path, layout.shallow_path, layout.linear_path))
    record = manifest.files.get(LENS_FILE)
    if record is None or not (other / LENS_FILE).is_file() or sha256_file(other / LENS_FILE) != record.sha256:
        raise InputError(other / LENS_FILE, "a changed file", f"the one that {MANIFEST} lists")
    lenses = read_lens_file(other)
    if isinstance(lenses, LensFile) and lenses.thinlens is not None:
        for view in lenses.known:
            if view.aperture > 0:
                write_json(noise_file(out, view.name), {name: getattr(view, name) for name in NOISE})


def _copy(other: Path, manifest: Manifest, out: Path, places: Sequence[Callable[[Path, str], Path]]) -> None:
    """Copy the files of these kinds that `out` lacks and that are as the manifest says, and the record of the depth
    once all its maps are there."""
    views = [image.view for image in manifest.source.images]
    for view in views:
        for place in places:
            file, path = layout.relative(place, view), place(out, view)
            record = manifest.files.get(file)
            source = other / file
            if record is None or path.is_file() or not source.is_file() or sha256_file(source) != record.sha256:
                continue
            with replacing(path) as temporary:
                shutil.copyfile(source, temporary)
    whole = all(place(out, view).is_file() for place in _TRUTH for view in views)
    if whole and manifest.depth is not None:
        write_json(out / WORK / DEPTH_RECORD, manifest.depth.model_dump(mode="json"))
