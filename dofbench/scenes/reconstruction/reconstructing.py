"""Run `reconstruct`: photographs, features, matches, mapping, undistortion; each stage is kept when it is finished."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench import __version__
from dofbench.core.cameras import NO_OFFSET, Offset
from dofbench.core.errors import InputError
from dofbench.core.file_lock import only_writer
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.image_files.exif import write_exif
from dofbench.core.images import read_exr, read_image, write_exr, write_png
from dofbench.core.masks import read_mask, write_mask
from dofbench.core.progress import Progress
from dofbench.scenes import export
from dofbench.scenes.on_disk import undistort_mask
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.reconstruction.features import group_by_camera
from dofbench.scenes.reconstruction.kept_steps import RECORD, Work
from dofbench.scenes.reconstruction.mapping import map_photographs, triangulate
from dofbench.scenes.reconstruction.matching import compare, verified
from dofbench.scenes.reconstruction.photograph_list import LEAST, Prepared, prepare
from dofbench.scenes.reconstruction.photograph_source import Source, find_source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.report import record, remarks, view_reports
from dofbench.scenes.undistort import Intrinsics, undistort_image, undistorted
from dofbench.scenes.visibility import in_front

_MAPPING = "mapping.json"
# Seconds between two signs of life of a stage of unknown length.
_SIGN = 30.0
Say = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """folder: of the scene, None without one. remarks: lines for the user, on photographs without a pose."""

    folder: Path | None
    remarks: tuple[str, ...] = ()


def run(settings: Reconstruct, progress: Progress, say: Say | None = None) -> Outcome:
    """Make the scene, resume it, or find it complete; see `dofbench.scenes.reconstruction`.

    say: receives notes and signs of life; None prints them on standard error.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    if settings.mapping == "global" and not hasattr(pycolmap, "global_mapping"):
        found = f"global, which pycolmap {pycolmap.__version__} doesn't have"
        raise InputError("--mapping", found, "incremental, or a newer pycolmap")
    # COLMAP's log names neither photographs nor stages, and overwrites the progress display.
    pycolmap.logging.minloglevel = 3
    say = say or _print
    source = find_source(settings)
    if source.kind == "photographs":  # a scene's notes were printed when it was read
        for note in source.notes:
            say(f"{settings.source}: {note}")
    digests = source.digests()
    content = {
        "settings": settings.recipe(),
        "kind": source.kind,
        "files": digests,
        **({"poses": source.poses} if source.poses else {}),
        "dofbench": __version__,
        "pycolmap": pycolmap.__version__,
    }
    identity = sha256_text(canonical_json(content))
    with only_writer(settings.out):
        work = Work(settings.out)
        if work.begin(identity) == "complete":
            progress.finished(settings.out, f"up to date: {_summary(read_json(settings.out / RECORD))}")
            return Outcome(settings.out)
        return _stages(settings, source, digests, identity, work, progress, say)


def _stages(
    settings: Reconstruct,
    source: Source,
    digests: dict[str, str],
    identity: str,
    work: Work,
    progress: Progress,
    say: Say,
) -> Outcome:
    photographs = _photographs(settings, source, work, progress)
    video = source.kind == "video"
    cameras = "shared" if video else settings.cameras
    groups = [] if source.kind == "poses" else group_by_camera(photographs, cameras, settings.sensor_width)
    folders = work.database, work.photographs
    compared = compare(*folders, photographs, groups, progress, settings, video=video, timed=work.timed)
    found = _map(settings, source, work, photographs, progress, say)
    model = _read(work.model) if found is not None else None
    agreed = verified(work.database, photographs)
    others = [] if found is None else found["others"]
    views = view_reports(photographs, compared.features, agreed, model, others)
    lines = tuple(remarks(views, video))
    if model is None or found is None:
        nothing = (
            f"{settings.out}: no scene: no {LEAST} of the {len(photographs)} photographs hang together; rerun the same "
            "command to resume from the finished stages"
        )
        return Outcome(None, (*lines, nothing))
    with work.timed("undistortion"), progress.stage("undistortion", model.num_reg_images()) as advance:
        placed = write_scene(work, photographs, source.holds_split, advance, source.offset)
    matching = {"mode": compared.matching, "pairs": len(compared.pairs), "verified_pairs": len(agreed)}
    steps = {"matching": matching, "mapping": found, "seconds": work.seconds()}
    content = record(settings, source, digests, identity, groups, views, model, placed, **steps)
    write_json(work.scene / RECORD, content)
    work.finish()
    progress.finished(settings.out, _summary(content))
    return Outcome(settings.out, lines)


def _photographs(settings: Reconstruct, source: Source, work: Work, progress: Progress) -> list[Prepared]:
    if source.count:
        with work.timed("frames"), progress.stage("frames", source.count) as advance:
            photographs = source.photographs(work.folder / "frames", advance)
    else:
        photographs = source.photographs(work.folder, lambda done: None)
    with work.timed("photographs"), progress.stage("photographs", len(photographs)) as advance:
        return prepare(photographs, work.photographs, settings.size, advance)


def _map(
    settings: Reconstruct, source: Source, work: Work, photographs: Sequence[Prepared], progress: Progress, say: Say
) -> dict[str, Any] | None:
    """Make the model in `work.model`, unless it is there. Returns the record of how; None without a model."""
    if work.model.is_dir():
        return read_json(work.folder / _MAPPING)
    known = source.kind == "poses"
    stage = "points" if known else "mapping"
    folders, seed = (work.database, work.photographs, work.folder), settings.seed
    with work.timed("mapping"), progress.stage(stage, len(photographs)) as advance:
        sign = _Signs(stage, say)
        if known:
            model = triangulate(*folders, photographs, seed, sign)
            if not model.num_points3D():
                return None
            how: dict[str, Any] = {"how": "poses kept, points triangulated", "others": []}
        else:
            count, mapping = len(photographs), settings.mapping
            mapped = map_photographs(*folders, count, mapping=mapping, seed=seed, advance=advance, sign=sign)
            if mapped is None:
                return None
            model = mapped.model
            names = {photograph.file_name: photograph.name for photograph in photographs}
            others = [[names[file] for file in part] for part in mapped.others]
            how = {"how": mapping, "demands": mapped.attempt, "others": others}
    write_json(work.folder / _MAPPING, how)
    unfinished = work.folder / "model.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    model.write_binary(unfinished)
    unfinished.rename(work.model)
    return how


class _Signs:
    """Reports from time to time that a stage of unknown length goes on."""

    def __init__(self, stage: str, say: Say):
        self._stage, self._say = stage, say
        self._start = self._last = time.monotonic()

    def __call__(self) -> None:
        now = time.monotonic()
        if now - self._last >= _SIGN:
            self._last = now
            self._say(f"{self._stage}: {now - self._start:.0f} s so far; COLMAP doesn't say how much is left")


def write_scene(
    work: Work,
    photographs: Sequence[Prepared],
    holds_split: bool,
    advance: Callable[[int], None],
    offset: Offset = NO_OFFSET,
) -> dict[str, Intrinsics]:
    """Write the scene into `work.scene` from the model in `work.model`; returns each view's camera with distortion.

    holds_split: write the split, in transforms.json, which readers take before the model. advance: called with the
    number of photographs done. offset: added to all positions.
    """
    model = read_model(work.model)
    by_file = {photograph.file_name: photograph for photograph in photographs}
    views = [by_file[name] for name in model.names]
    # Linear light stays light, so that a dataset of the scene can blur what is brighter than white.
    names = [f"{view.name}.png" if view.light is None else f"{view.name}.exr" for view in views]
    cameras = []
    for index, (view, lens, pose) in enumerate(zip(views, model.intrinsics, model.world_to_camera, strict=True)):
        cameras.append(undistorted(lens).camera(pose))
        path = work.scene / "images" / names[index]
        if not path.is_file() and view.light is not None:
            write_exr(path, undistort_image(read_exr(view.light), lens, light=True), half=True)
        elif not path.is_file():
            write_png(path, undistort_image(read_image(work.photographs / view.file_name), lens))
        if view.mask is not None and not (mask := work.scene / "masks" / f"{names[index]}.png").is_file():
            write_mask(mask, undistort_mask(read_mask(view.mask), lens))
        advance(index + 1)
    points = None if model.points is None else in_front(model.points, cameras)
    export.write_colmap(work.scene, names, cameras, points, offset)
    if holds_split:
        images = [f"images/{name}" for name in names]
        splits = [view.split or "train" for view in views]
        masks = [
            {"mask_path": f"masks/{name}.png"} if view.mask else {} for view, name in zip(views, names, strict=True)
        ]
        path = work.scene / "transforms.json"
        export.write_transforms(path, images, cameras, splits=splits, extra=masks, offset=offset)
    if exif := {view.name: view.exif for view in views if view.exif is not None}:
        write_exif(work.scene, exif)
    return {view.name: lens for view, lens in zip(views, model.intrinsics, strict=True)}


def _read(folder: Path) -> Any:
    from dofbench.scenes.colmap_binding import pycolmap

    model = pycolmap.Reconstruction()
    model.read_binary(folder)
    return model


def _summary(content: dict[str, Any]) -> str:
    done = sum(view["registered"] for view in content["views"])
    return (
        f"{done} of {len(content['views'])} photographs have poses, {content['points']} points, "
        f"{content['mean_reprojection_error']:.2f} px"
    )


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
