"""The run of `reconstruct`: photographs, features, matches, mapping, undistortion, each kept when it is finished."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench import __version__
from dofbench.core.errors import InputError
from dofbench.core.file_lock import only_writer
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.progress import Progress
from dofbench.scenes.reconstruction.comparing import compare
from dofbench.scenes.reconstruction.focal_length import group_by_camera
from dofbench.scenes.reconstruction.kept_steps import RECORD, Work
from dofbench.scenes.reconstruction.mapping import map_photographs, triangulate
from dofbench.scenes.reconstruction.matching import verified
from dofbench.scenes.reconstruction.photograph_list import LEAST, Prepared, prepare
from dofbench.scenes.reconstruction.photograph_source import Source, find_source
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.reconstruction_record import record
from dofbench.scenes.reconstruction.registration_report import remarks, view_reports
from dofbench.scenes.reconstruction.scene_writing import write_scene

_MAPPING = "mapping.json"
# Seconds between two signs of life of a stage that can't say how far it is.
_SIGN = 30.0


@dataclass(frozen=True)
class Outcome:
    """folder: of the scene, None where none came of it. remarks: lines for the user, on what has no pose and why."""

    folder: Path | None
    remarks: tuple[str, ...] = ()


def run(settings: Reconstruct, progress: Progress, say: Callable[[str], None] | None = None) -> Outcome:
    """Make the scene, or finish it, or find that it is complete; see `dofbench.scenes.reconstruction.reconstructing`.

    say: told that a stage of unknown length goes on; None prints it on standard error.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    if settings.mapping == "global" and not hasattr(pycolmap, "global_mapping"):
        found = f"global, which pycolmap {pycolmap.__version__} doesn't have"
        raise InputError("--mapping", found, "incremental, or a newer pycolmap")
    # COLMAP's log names neither photographs nor stages, and overwrites the progress display.
    pycolmap.logging.minloglevel = 3
    source = find_source(settings)
    if source.kind == "photographs":  # a scene's notes were printed when it was read
        for note in source.notes:
            (say or _print)(f"{settings.source}: {note}")
    digests = source.digests()
    identity = sha256_text(
        canonical_json(
            {
                "settings": settings.recipe(),
                "kind": source.kind,
                "files": digests,
                **({"poses": source.poses} if source.poses else {}),
                "dofbench": __version__,
                "pycolmap": pycolmap.__version__,
            }
        )
    )
    with only_writer(settings.out):
        work = Work(settings.out)
        if work.begin(identity) == "complete":
            progress.finished(settings.out, f"up to date: {_summary(read_json(settings.out / RECORD))}")
            return Outcome(settings.out)
        return _stages(settings, source, digests, identity, work, progress, say or _print)


def _stages(
    settings: Reconstruct,
    source: Source,
    digests: dict[str, str],
    identity: str,
    work: Work,
    progress: Progress,
    say: Callable[[str], None],
) -> Outcome:
    photographs = _photographs(settings, source, work, progress)
    groups = (
        []
        if source.kind == "poses"
        else group_by_camera(
            photographs, "shared" if source.kind == "video" else settings.cameras, settings.sensor_width
        )
    )
    compared = compare(
        work.database,
        work.photographs,
        photographs,
        groups,
        progress,
        matching=settings.matching,
        camera_model=settings.camera_model,
        most=settings.features,
        seed=settings.seed,
        video=source.kind == "video",
        timed=work.timed,
    )
    found = _map(settings, source, work, photographs, progress, say)
    model = _read(work.model) if found is not None else None
    agreed = verified(work.database, photographs)
    others = [] if found is None else found["others"]
    views = view_reports(photographs, compared.features, agreed, model, others)
    lines = tuple(remarks(views, source.kind == "video"))
    if model is None or found is None:
        nothing = (
            f"{settings.out}: no scene: no {LEAST} of the {len(photographs)} photographs hang together; what is "
            "finished stays, and the same command goes on from it"
        )
        return Outcome(None, (*lines, nothing))
    with work.timed("undistortion"), progress.stage("undistortion", model.num_reg_images()) as advance:
        placed = write_scene(work, photographs, source.holds_split, advance, source.offset)
    content = record(
        settings,
        source,
        digests,
        identity,
        groups,
        views,
        model,
        placed,
        mapping=found,
        seconds=work.seconds(),
        matching={"mode": compared.matching, "pairs": len(compared.pairs), "verified_pairs": len(agreed)},
    )
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
    settings: Reconstruct,
    source: Source,
    work: Work,
    photographs: Sequence[Prepared],
    progress: Progress,
    say: Callable[[str], None],
) -> dict[str, Any] | None:
    """Make the model in `work.model`, unless it is there. Returns what is to be said of how; None without a model."""
    if work.model.is_dir():
        return read_json(work.folder / _MAPPING)
    known = source.kind == "poses"
    with work.timed("mapping"), progress.stage("points" if known else "mapping", len(photographs)) as advance:
        sign = _Signs("points" if known else "mapping", say)
        if known:
            model = triangulate(work.database, work.photographs, work.folder, photographs, settings.seed, sign)
            if not model.num_points3D():
                return None
            how: dict[str, Any] = {"how": "poses kept, points triangulated", "others": []}
        else:
            mapped = map_photographs(
                work.database,
                work.photographs,
                work.folder,
                len(photographs),
                mapping=settings.mapping,
                seed=settings.seed,
                advance=advance,
                sign=sign,
            )
            if mapped is None:
                return None
            model = mapped.model
            names = {photograph.file_name: photograph.name for photograph in photographs}
            how = {
                "how": settings.mapping,
                "demands": mapped.attempt,
                "others": [[names[file] for file in part] for part in mapped.others],
            }
    write_json(work.folder / _MAPPING, how)
    unfinished = work.folder / "model.part"
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir()
    model.write_binary(unfinished)
    unfinished.rename(work.model)
    return how


class _Signs:
    """Says now and then that a stage goes on whose end nobody knows."""

    def __init__(self, stage: str, say: Callable[[str], None]):
        self._stage, self._say = stage, say
        self._start = self._last = time.monotonic()

    def __call__(self) -> None:
        now = time.monotonic()
        if now - self._last >= _SIGN:
            self._last = now
            self._say(f"{self._stage}: {now - self._start:.0f} s so far; COLMAP doesn't say how much is left")


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
