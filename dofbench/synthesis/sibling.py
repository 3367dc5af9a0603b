"""Copies sharp images and depth from a finished dataset of the same scene with another lens."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

from dofbench.core.files import replacing, sha256_file, write_json
from dofbench.dataset import layout
from dofbench.dataset.schema import MANIFEST, SourceRecord, read_manifest
from dofbench.synthesis.dataset_options import DatasetOptions, MakeDataset
from dofbench.synthesis.work import DEPTH_RECORD, WORK


def take_over(sibling: Path, out: Path, source: SourceRecord, settings: MakeDataset) -> None:
    """Copy files missing in `out` from the dataset `sibling`, if it is complete and its sharp images and depth were
    made in the same way."""
    if not (sibling / MANIFEST).is_file():
        return
    manifest = read_manifest(sibling)
    same = (manifest.source.geometry, manifest.source.images) == (source.geometry, source.images)
    recipe = settings.recipe()
    sharp = [at.name for at in fields(DatasetOptions) if at.metadata.get("sharp")]
    if not same or any(manifest.settings.get(name) != recipe[name] for name in sharp):
        return
    places = (layout.sharp_path, layout.depth_path, layout.confidence_path)
    for image in source.images:
        for place in places:
            file, path = layout.relative(place, image.view), place(out, image.view)
            record = manifest.files.get(file)
            if record is not None and not path.is_file() and sha256_file(sibling / file) == record.sha256:
                with replacing(path) as temporary:
                    shutil.copyfile(sibling / file, temporary)
    whole = all(place(out, image.view).is_file() for place in places for image in source.images)
    if whole and manifest.depth is not None:
        write_json(out / WORK / DEPTH_RECORD, manifest.depth.model_dump(mode="json"))
