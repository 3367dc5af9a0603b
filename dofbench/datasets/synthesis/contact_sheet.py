"""The contact sheet: a few views of the dataset side by side, as an overview."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from dofbench.core.lens import DisparityRange
from dofbench.datasets.format.schema import ViewRecord
from dofbench.datasets.synthesis.sheet_drawing import Column, Panel, coloured, draw
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.depth.disparity import disparity_of
from dofbench.scenes.scene import Scene, SceneView, Split

_ROWS = 6
DISPARITY, COC = cv2.COLORMAP_VIRIDIS, cv2.COLORMAP_INFERNO
_DEPTH = Column("depth", DISPARITY, ("far", "near"))


@dataclass(frozen=True, eq=False)
class SheetRow:
    """One view. sharp, shallow: (H, W, 3) uint8, encoded; depth: (H, W) float32, scene units, 0 unknown."""

    record: ViewRecord
    sharp: np.ndarray
    depth: np.ndarray
    shallow: np.ndarray


@dataclass(frozen=True, eq=False)
class PhotographRow:
    """One view of unknown lens. photograph, sharp: (H, W, 3) uint8, encoded; depth: (H, W) float32, scene units. sharp
    and depth may be None."""

    name: str
    split: Split
    photograph: np.ndarray
    sharp: np.ndarray | None
    depth: np.ndarray | None


def choose_rows(records: Sequence[ViewRecord], count: int = _ROWS) -> list[ViewRecord]:
    """A few views that show different lenses: at most `count`, among them a test view if there is one.

    First views whose (A, F) isn't among those chosen yet, in name order, then the remaining views.
    """
    training = [record for record in records if record.split == "train"]
    testing = [record for record in records if record.split == "test"]
    chosen: list[ViewRecord] = []
    for pool, room in ((training, count - bool(testing)), (testing, count)):
        seen = {(record.aperture, record.focus) for record in chosen}
        fresh: list[ViewRecord] = []
        others: list[ViewRecord] = []
        for record in pool:
            lens = (record.aperture, record.focus)
            (others if lens in seen else fresh).append(record)
            seen.add(lens)
        chosen += (fresh + others)[: max(0, room - len(chosen))]
    return sorted(chosen, key=lambda record: record.name)


def choose_photographs(scene: Scene, count: int = _ROWS) -> list[SceneView]:
    """A few views: at most `count`, evenly chosen from each split, half of them test views if there are enough."""
    chosen: list[SceneView] = []
    testing, training = ([view for view in scene.views if view.split == split] for split in ("test", "train"))
    for pool, room in ((testing, count // 2), (training, count)):
        room = min(len(pool), room - len(chosen))
        chosen += [pool[index * len(pool) // room] for index in range(room)]
    return sorted(chosen, key=lambda view: view.name)


def contact_sheet(
    title: str,
    records: Sequence[ViewRecord],
    read: Callable[[ViewRecord], SheetRow],
    size: tuple[int, int],
    disparity_range: DisparityRange,
    at_once: int,
) -> np.ndarray:
    """Draw the sheet of views with a known lens; (H, W, 3) uint8. size: of every picture. at_once: views at a time.

    Depth is drawn as normalised disparity, the CoC radius up to the largest one on the sheet, each
    with its colour bar. Grey is unknown depth.
    """
    most = max([record.max_coc_px for record in records] + [1.0])

    def panels(record: ViewRecord) -> list[Panel]:
        row = read(record)
        known, width = row.depth > 0, row.depth.shape[1]
        radius = np.abs(record.lens.physical(disparity_range, width).signed_radius(disparity_of(row.depth), width))
        drawn = (
            Panel(row.sharp, f"{record.name}  ({record.split})"),
            _depth_panel(row.depth, disparity_range),
            Panel(coloured(radius / most, known, COC), f"up to {record.max_coc_px:.1f} px"),
            Panel(row.shallow, f"A {record.aperture:.3g}   F {record.focus:.3g}"),
        )
        return [panel.resized(size) for panel in drawn]

    columns = (Column("all in focus"), _DEPTH, Column("CoC radius", COC, ("0", f"{most:.1f} px")), Column("shallow"))
    return draw(title, columns, list(over_views(panels, records, at_once)), size)


def photographs_sheet(
    title: str,
    views: Sequence[SceneView],
    read: Callable[[SceneView], PhotographRow],
    size: tuple[int, int],
    disparity_range: DisparityRange | None,
    at_once: int,
) -> np.ndarray:
    """Draw the sheet of photographs of unknown lens; (H, W, 3) uint8. size: of every picture. at_once: views at a time.

    A column is drawn if any row has a picture for it; a missing picture is drawn as a grey panel with a note.
    """

    def panels(view: SceneView) -> list[Panel]:
        row = read(view)
        drawn = (
            Panel(row.photograph, f"{row.name}  ({row.split})"),
            Panel(row.sharp, "no such photograph" if row.sharp is None else ""),
            Panel(None, "unknown")
            if row.depth is None or disparity_range is None
            else _depth_panel(row.depth, disparity_range),
        )
        return [panel.resized(size) for panel in drawn]

    rows = list(over_views(panels, views, at_once))
    columns = (Column("photograph, lens unknown"), Column("all in focus"), _DEPTH)
    shown = [index for index in range(len(columns)) if any(row[index].picture is not None for row in rows)]
    return draw(title, [columns[index] for index in shown], [[row[index] for index in shown] for row in rows], size)


def _depth_panel(depth: np.ndarray, disparity_range: DisparityRange) -> Panel:
    known = depth > 0
    said = f"z {depth[known].min():.3g} to {depth[known].max():.3g}" if known.any() else "unknown"
    return Panel(coloured(disparity_range.normalise(disparity_of(depth)), known, DISPARITY), said)
