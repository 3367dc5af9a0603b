"""The pages of a report: one set for everything, or an overview and a set for each dataset."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.files import write_text
from dofbench.evaluation.comparing.pairwise import Pair
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.results.collecting import Collection, grouped
from dofbench.reporting.boards import Board, Names, Variant
from dofbench.reporting.pictures import BoardPictures, galleries, link
from dofbench.reporting.render import html, markdown
from dofbench.reporting.tables import Section
from dofbench.reporting.timing import CurveView
from dofbench.reporting.view import ReportView, Scene, build_overview, build_view, page_data

PAGES = {"report": "Pictures and tables", "curves": "Error against time", "scores": "Every score", "runs": "Runs"}
SCENES = "scenes"  # the folder of the datasets' folders
_OVERVIEW = {**PAGES, "report": "Overview"}
_FROM_A_SCENE = "../../"


@dataclass(frozen=True)
class Content:
    """What pages show. names: of the variants in the whole report. curves, means: by board, and of means over scenes.
    pairs, of_means: `pairwise` of each board by its key, and `mean_pairs`. most: rows of a table."""

    collection: Collection
    boards: Sequence[Board]
    names: Names
    curves: Sequence[CurveView]
    means: Sequence[CurveView]
    pairs: Mapping[Variant, Sequence[Pair]]
    of_means: Mapping[str, Sequence[Pair]]
    ablations: Sequence[Section]
    most: int


def write_together(
    out: Path, content: Content, gallery: Sequence[BoardPictures], strips: Mapping[Variant, str]
) -> list[Path]:
    """Write one set of pages with everything. strips: board -> file of its strip of pictures. Returns their files, the
    first page last."""
    view = build_view(
        content.collection,
        content.boards,
        content.names,
        curves=content.curves,
        mean_curves=content.means,
        pairs=content.pairs,
        of_means=content.of_means,
        strips=strips,
        gallery=gallery,
        ablations=content.ablations,
        most=content.most,
    )
    _drop_scenes(out / SCENES, ())
    return _write(out, view, PAGES)


def write_by_scene(out: Path, content: Content, *, pictures: bool, refocus: int) -> list[Path]:
    """Write an overview and, in `SCENES`, a set of pages for each dataset. pictures, refocus: whether to show pictures,
    and of how many models refocus frames (`galleries`). Returns their files, the overview's first page last."""
    files: list[Path] = []
    scenes: dict[tuple[str, ...], Scene] = {}
    curves, spent = grouped(content.curves, "board"), 0
    for boards in _by_dataset(content.boards):
        gallery = galleries(boards, refocus, spent) if pictures else []
        spent += sum(len(one.refocus) for one in gallery)
        name, entries = boards[0].name, tuple(entry for board in boards for entry in board.members)
        view = build_view(
            Collection(entries, (), (), ()),
            boards,
            content.names,
            curves=[curve for board in boards for curve in curves.get(board.key, ())],
            pairs=content.pairs,
            gallery=gallery,
            most=content.most,
            others=content.collection.entries,
            name=name,
        )
        folder = _folder(boards[0], {scene.folder for scene in scenes.values()})
        files += _write(out / folder, view, PAGES, _FROM_A_SCENE)
        scene = Scene(name, folder, bool(view.curves))
        scenes |= {board.key: scene for board in boards}
    link((), out / "pictures")  # those of an earlier, smaller report
    _drop_scenes(out / SCENES, [scene.folder for scene in scenes.values()])
    view = build_overview(
        content.collection,
        content.boards,
        content.names,
        scenes,
        mean_curves=content.means,
        pairs=content.pairs,
        of_means=content.of_means,
        ablations=content.ablations,
        most=content.most,
    )
    return files + _write(out, view, _OVERVIEW)


def _write(folder: Path, view: ReportView, titles: Mapping[str, str], up: str = "") -> list[Path]:
    """Write a set of pages and their pictures. up: from the folder to that of the overview, "" without one above."""
    files = [folder / "leaderboard.md"]
    write_text(files[0], markdown("leaderboard", view=view, up=up))
    known = {file: digest for board in view.gallery for file, digest in board.digests.items()}
    linked = link((file for board in view.gallery for file in board.files), folder / "pictures", known)
    pages = {name: title for name, title in titles.items() if name != "curves" or view.curves}
    data = page_data(view)
    for name in reversed(pages):
        files.append(folder / f"{name}.html")
        write_text(files[-1], html(name, view=view, files=linked, pages=pages, up=up, **data))
    return files


def _by_dataset(boards: Sequence[Board]) -> list[list[Board]]:
    found: dict[tuple[str, ...], list[Board]] = {}
    for board in boards:
        found.setdefault(board.key[:2], []).append(board)
    return list(found.values())


def datasets(boards: Sequence[Board]) -> int:
    """The number of datasets."""
    return len(_by_dataset(boards))


def _folder(board: Board, taken: Container[str]) -> str:
    """The folder of a dataset's pages; its checksum is in it where another's name differs in a sign alone."""
    names = (file_name(name) for name in (board.name, f"{board.name}@{board.key[1]}"))
    return next(folder for name in names if (folder := f"{SCENES}/{name}") not in taken)


def _drop_scenes(folder: Path, kept: Sequence[str]) -> None:
    """Remove the pages of datasets that an earlier report had, and nothing else."""
    names = {Path(one).name for one in kept}
    for old in [one for one in folder.glob("*/") if one.name not in names]:
        for page in ("leaderboard.md", *(f"{name}.html" for name in PAGES)):
            (old / page).unlink(missing_ok=True)
        link((), old / "pictures")
        for place in (old / "pictures", old):
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
