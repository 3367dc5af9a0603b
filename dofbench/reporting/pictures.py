"""Pictures of test views (truth, predictions, error maps), refocus frames and films, as files and as the page has them.

A picture whose checksum isn't the one in the result is not shown; the reason is.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from dofbench.core.errors import InputError, Status
from dofbench.core.files import replacing, sha256_file
from dofbench.core.images import image_size
from dofbench.datasets.format import layout
from dofbench.datasets.format.dataset import Dataset
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.evaluation.results.result import PREDICTIONS_FOLDER, Result
from dofbench.evaluation.scoring.evaluate import PREFIX, Kind
from dofbench.reporting.boards import Board
from dofbench.reporting.tables import one_line
from dofbench.running.load_run import LoadedRun, loaded
from dofbench.running.refocus_frames import refocus_frames

TITLES: dict[Kind, str] = {
    "refocus": "through the view's own lens",
    "all_in_focus": "all in focus",
    "photograph": "lens fitted on half of the tiles",
    "across": "learned aperture scaled, focus fitted on half of the tiles",
}
NOT_THERE = "the picture isn't next to the result, or isn't the one that was scored"
FILM = "film/film.mp4"  # in a result's folder, as `dofbench render RESULT --out RESULT/film` writes it
PLACES = 3000  # of predictions in one page, above which it has fewer test views of each dataset
ROWS = 100  # of a board that have pictures, the best ones
_SHOWN = ("psnr", "ssim", "flip")


@dataclass(frozen=True)
class RunPictures:
    """The pictures of one run and view. picture, error, resolved: PNG files, or None. reason: why there is no picture.
    scores: (heading, value) as shown. digests: sha256 by file."""

    name: str
    picture: Path | None
    reason: str
    error: Path | None
    resolved: Path | None
    scores: tuple[tuple[str, str], ...]
    digests: Mapping[Path, str] = field(default_factory=dict)


@dataclass(frozen=True)
class KindPictures:
    """One kind of prediction of a view. truth: PNG file that predictions were compared with; None if it is missing, for
    the `reason`."""

    kind: Kind
    title: str
    truth: Path | None
    reason: str
    runs: tuple[RunPictures, ...]

    @property
    def best_first(self) -> list[RunPictures]:
        """The runs by their first score, which is a PSNR, the best first; then runs without one."""

        def place(run: RunPictures) -> tuple[bool, float]:
            value = float(run.scores[0][1]) if run.scores else math.nan
            return math.isnan(value), -value

        return sorted(self.runs, key=place)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the pictures."""
        return image_size(next(file for file in (self.truth, *(run.picture for run in self.runs)) if file))


@dataclass(frozen=True)
class ViewPictures:
    """One test view. lens: a text such as "F 0.2, A 1", "" if it is unknown."""

    name: str
    lens: str
    kinds: tuple[KindPictures, ...]


@dataclass(frozen=True)
class Moving:
    """What one run shows of a view in motion: refocus frames, far to near, or a film."""

    name: str
    files: tuple[Path, ...]


@dataclass(frozen=True)
class BoardPictures:
    """The test views of one board that have a picture. trouble: the reason if no view has one. refocus, films: of the
    runs that have some. omitted: what isn't shown, and why, one line each."""

    board: str
    views: tuple[ViewPictures, ...]
    trouble: str = ""
    refocus: tuple[Moving, ...] = ()
    films: tuple[Moving, ...] = ()
    omitted: tuple[str, ...] = ()

    @property
    def files(self) -> Iterator[Path]:
        """Every file that the page shows."""
        for kind in (kind for view in self.views for kind in view.kinds):
            of_runs = (file for run in kind.runs for file in (run.picture, run.error, run.resolved))
            yield from filter(None, (kind.truth, *of_runs))
        yield from (file for moving in (*self.refocus, *self.films) for file in moving.files)

    @property
    def digests(self) -> dict[Path, str]:
        """sha256 of those that are known by it."""
        runs = (run for view in self.views for kind in view.kinds for run in kind.runs)
        return {file: digest for run in runs for file, digest in run.digests.items()}


# ---- files ----


def galleries(boards: Sequence[Board], refocus: int = 0, spent: int = 0) -> list[BoardPictures]:
    """The pictures of each board, by the first seed of each row whose run ended well. refocus: models to show refocus
    frames of, from the first board and its best row on; missing frames are rendered. spent: models of other pages."""
    found, left = [], refocus - spent
    for board in boards:
        every = sorted(_with_predictions(board), key=lambda one: _quality(one[1]), reverse=True)
        shown = [(name, entry, loaded(entry.folder, result)) for name, entry, result in every[:ROWS]]
        views = tuple(_views(board, shown)) if shown else ()
        trouble = "" if views else "the predictions aren't next to the results" if shown else "no run has predictions"
        frames, omitted = _refocus(shown, left) if refocus else ((), ())
        left -= len(frames)
        if len(every) > len(shown):
            omitted = (f"pictures are of the best {ROWS} of {len(every)} rows", *omitted)
        films = tuple(Moving(name, (run.folder / FILM,)) for name, _, run in shown if (run.folder / FILM).is_file())
        found.append(BoardPictures(board.title, views, trouble, frames, films, omitted))
    places = sum(len(kind.runs) for board in found for view in board.views for kind in view.kinds)
    step = -(-places // PLACES)
    if step <= 1:
        return found
    said = f"one test view of {step} is shown, to keep the page small"
    return [replace(one, views=one.views[::step], omitted=(*one.omitted, said)) for one in found]


def _refocus(shown: Sequence[tuple[str, Entry, LoadedRun]], most: int) -> tuple[tuple[Moving, ...], tuple[str, ...]]:
    """(the refocus frames of at most so many runs that can refocus, a line on each run without that could)."""
    found: list[Moving] = []
    omitted = []
    for place, (name, _, run) in enumerate(shown):
        if len(found) == most:
            omitted.append(f"no refocus frames of the last {len(shown) - place} rows, to which --refocus doesn't reach")
            break
        try:
            files = refocus_frames(loaded(run.folder, run.result, run.data))  # not `run`, which would keep the model
        except Exception as error:  # whatever a method's own code raises at a model that it can't read
            omitted.append(f"no refocus frames of {name}: {one_line(str(error))}")
            continue
        if files:
            found.append(Moving(name, files))
    return tuple(found), tuple(omitted)


def _quality(entry: Entry) -> float:
    return next((entry.scores[one] for one in ("psnr", "photo_psnr", "across_psnr") if one in entry.scores), -math.inf)


def _with_predictions(board: Board) -> Iterator[tuple[str, Entry, Result]]:
    """(name, entry, result) of each variant's first seed whose run ended well."""
    for variant, seeds in board.variants.items():
        for entry in seeds:
            if entry.status is Status.OK and entry.result and entry.result.views:
                line = board.lines[variant]
                yield f"{line.name}, seed {entry.spec.seed}", entry, entry.result
                break


def _views(board: Board, shown: Sequence[tuple[str, Entry, LoadedRun]]) -> Iterator[ViewPictures]:
    dataset, trouble = _dataset([run for _, _, run in shown])
    lenses = (shown[0][1].lenses or {}).get("test", {})
    for name in dict.fromkeys(view.name for entry in board.members if entry.result for view in entry.result.views):
        kinds = []
        for kind in PREFIX:
            runs = tuple(_run(*one, kind, name) for one in shown)
            if any(run.picture for run in runs):
                truth, reason = _truth(dataset, kind, name) if dataset is not None else (None, trouble)
                kinds.append(KindPictures(kind, TITLES[kind], truth, reason, runs))
        if kinds:
            lens = lenses.get(name)
            yield ViewPictures(name, "" if lens is None else f"F {lens[1]:g}, A {lens[0]:g}", tuple(kinds))


def _dataset(runs: Sequence[LoadedRun]) -> tuple[Dataset | None, str]:
    """(the dataset that these runs were scored on, "") or (None, why it can't be used)."""
    reason = ""
    for run in runs:
        try:
            return run.dataset, ""
        except InputError as error:
            reason = f"the dataset {run.result.spec.dataset} can't be used: {error}"
    return None, reason


def _truth(dataset: Dataset, kind: Kind, name: str) -> tuple[Path | None, str]:
    """(the picture that predictions of this kind were compared with, "") or (None, why it can't be used)."""
    part: Literal["image", "all_in_focus"] = "all_in_focus" if kind == "all_in_focus" else "image"
    try:
        dataset.require_intact(dataset.view(name), part)
    except InputError as error:
        return None, str(error)
    place = layout.sharp_path if part == "all_in_focus" else layout.shallow_path
    return place(dataset.folder, name), ""


def _run(name: str, entry: Entry, run: LoadedRun, kind: Kind, view: str) -> RunPictures:
    digests: dict[Path, str] = {}
    there = (run.folder / PREDICTIONS_FOLDER).is_dir()  # asked once: a hundred thousand files may not be there

    def file(folder: str) -> Path | None:
        if not there:
            return None
        try:
            found = run.prediction(folder, view)
        except InputError:
            return None
        digests[found] = run.result.predictions[f"{PREDICTIONS_FOLDER}/{folder}/{view}.png"]
        return found

    picture = file(kind)
    reason = "" if picture else entry.left_out.get(f"{PREFIX[kind]}psnr", NOT_THERE)
    scores = next((one.scores for one in run.result.views if one.name == view), {})
    columns = [COLUMNS[PREFIX[kind] + metric] for metric in _SHOWN if PREFIX[kind] + metric in scores]
    # The resolved map depends on the view alone, so it is shown only once, not next to the refocused prediction.
    resolved = file("resolved") if kind != "refocus" else None
    shown = tuple((column.heading, column.text(scores[column.id])) for column in columns)
    return RunPictures(name, picture, reason, file(f"{kind}_error"), resolved, shown, digests)


# ---- in the report's folder ----

_LINKED = re.compile(r"[0-9a-f]{16}\.\w+")


def link(files: Iterable[Path], folder: Path, digests: Mapping[Path, str] = {}) -> dict[Path, str]:
    """Put the files into `folder` by names of their content; returns file -> FOLDER/NAME. They are hard links where the
    file system has them, which take no space, else copies. Files of such names from before are removed. digests: sha256
    of files that need not be read for it."""
    names = {file: f"{(digests.get(file) or sha256_file(file))[:16]}{file.suffix}" for file in dict.fromkeys(files)}
    for file, name in names.items():
        if not (folder / name).exists():
            with replacing(folder / name) as temporary:
                try:
                    temporary.unlink()
                    os.link(file, temporary)
                except OSError:
                    shutil.copyfile(file, temporary)
    kept = set(names.values())
    for old in folder.glob("*") if folder.is_dir() else ():
        if _LINKED.fullmatch(old.name) and old.name not in kept:
            old.unlink()
    return {file: f"{folder.name}/{name}" for file, name in names.items()}
