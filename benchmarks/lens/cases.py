"""The cases of `check.py`: small datasets, and the training views that are used.

A case is a dataset, some of its training views, with or without defocus, and the truth: whether there is a lens, and
whether the views share it. Cases of one kind are in random order, and kinds alternate, so that the first part of
the list is a representative sample of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dofbench.core.content import content_folder
from dofbench.core.contracts import TrainingSet
from dofbench.core.progress import Silent
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.inputs import Inputs
from dofbench.datasets.synthesis.builder import make
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes.procedural import make_scene
from dofbench.scenes.procedural.scene_options import DEVELOPMENT, MakeScene

FEW = 6  # photographs of the smallest subsets
FAINT = 0.75  # px: with smaller true circles of confusion, either decision counts as right
LOW_CONTRAST = 0.15
ALL_BUT_SHARP = 11.0  # f-number from which on blowtorch is "all but sharp" by its README

# Lenses of the photographs, as options of make-dataset.
LENSES = {
    "multi": {"aperture": (0.5, 1.0)},
    "a0.1": {"aperture": (0.1,)},
    "a0.25": {"aperture": (0.25,)},
    "a0.5": {"aperture": (0.5,)},
    "a1": {"aperture": (1.0,)},
    "one0.5": {"aperture": (0.5,), "focus": (0.5,), "assign": "fixed"},
    "one1": {"aperture": (1.0,), "focus": (0.8,), "assign": "fixed"},
    "noise0": {"aperture": (0.0,), "photons": 300.0, "read_noise": 0.01},
    "noise0.5": {"aperture": (0.5,), "photons": 300.0, "read_noise": 0.01},
}
LARGE, SMALL = tuple(LENSES), ("multi", "a0.1", "a0.25", "a0.5", "a1", "one0.5", "one1")
WIDTHS = {"llff_fern": 252, "llff_flower": 252, "tabletop": 256}
REAL = {"shallow_blowtorch": ("colmap", 265), "shallow_chessking": ("auto", 250), "nerf_fox": ("auto", 135)}
THINLENS = ("fence", "foliage", "night")


@dataclass(frozen=True)
class Case:
    """Some training photographs of a dataset.

    folder: of the dataset, below the folder of all datasets. subset: "all", "half", "few" or "f/N", the photographs at
    that f-number. contrast: factor on the photographs' contrast. lens: "yes", "no", "faint", or None if it follows from
    the true lens and depth. share: what all photographs have in common, "scene" (the lens), "aperture", "exif"
    (aperture times f-number) or "view" (nothing); None if unknown or without a lens.
    """

    kind: str
    folder: str
    inputs: Inputs = "shallow"
    subset: str = "all"
    contrast: float = 1.0
    lens: str | None = None
    share: str | None = None

    @property
    def name(self) -> str:
        """The case's name in the table."""
        parts = (
            self.folder,
            self.inputs if self.inputs != "shallow" else "",
            self.subset,
            f"contrast {self.contrast:g}" if self.contrast != 1 else "",
        )
        return " ".join(filter(None, parts))


def cases() -> list[Case]:
    """All cases, with alternating kinds."""
    kinds: dict[str, list[Case]] = {}
    for case in _every():
        kinds.setdefault(case.kind, []).append(case)
    random = np.random.default_rng(0)
    dealt = [[some[i] for i in random.permutation(len(some))] for some in kinds.values()]
    return [case for turn in itertools.zip_longest(*dealt) for case in turn if case is not None]


def _every() -> Iterator[Case]:
    for group in ("all", "half", "few"):
        yield Case("real lens", "shallow_chessking", subset=group, lens="yes")
        yield Case("sharp", "nerf_fox", subset=group, lens="no")
    for group in ("f/5", "f/6.3", "f/5 few", "f/6.3 few", "f/6.3 half"):
        yield Case("real lens", "shallow_blowtorch", subset=group, lens="yes", share="aperture")
    for group in ("f/14", "f/14 half", "f/14 few"):
        yield Case("f/14", "shallow_blowtorch", subset=group, lens="faint", share="aperture")
    for group in ("all", "half"):
        yield Case("real lens", "shallow_blowtorch", subset=group, lens="yes", share="exif")
    for scene in (*WIDTHS, *(f"rendered_{name}" for name in DEVELOPMENT)):
        large = scene in WIDTHS
        for subset in ("all", "half", "few"):
            if not large and subset == "half":
                continue  # left out, because half of ten photographs is about the subset "few"
            yield Case("sharp", f"{scene}/multi", "all-in-focus", subset, lens="no")
            for lens in LARGE if large else SMALL:
                share = {"multi": "view", "one0.5": "scene", "one1": "scene", "noise0": None}.get(lens, "aperture")
                kind = {
                    "multi": "grid",
                    "one0.5": "one lens",
                    "one1": "one lens",
                    "noise0": "sharp, noise",
                    "noise0.5": "noise",
                }.get(lens, f"A {lens[1:]}")
                yield Case(kind, f"{scene}/{lens}", subset=subset, lens="no" if lens == "noise0" else None, share=share)
            if large:
                yield Case("sharp, low contrast", f"{scene}/multi", "all-in-focus", subset, LOW_CONTRAST, "no")
                yield Case("low contrast", f"{scene}/a0.5", "shallow", subset, LOW_CONTRAST, share="aperture")
    for name in THINLENS:
        yield Case("sharp", f"thinlens_{name}/a1", "all-in-focus", lens="no")
        yield Case("A 1", f"thinlens_{name}/a1", share="aperture")


def load(case: Case, work: Path) -> tuple[Dataset, TrainingSet, list[int]]:
    """The dataset, the photographs of the case, and their numbers among the training views."""
    dataset = Dataset.load(work / case.folder)
    whole = dataset.training_set(case.inputs)
    chosen = chosen_views(case.subset, [view.exif and view.exif.f_number for view in whole.views])
    views = tuple(_faded(whole.views[i], case.contrast) for i in chosen)
    points = whole.points.seen_by(chosen)
    if case.contrast != 1:
        points = replace(points, rgb=(0.5 + case.contrast * (points.rgb - 0.5)).astype(np.float32))
    return dataset, TrainingSet(views, points), chosen


def chosen_views(subset: str, f_numbers: list[float | None]) -> list[int]:
    """Numbers of the photographs of a subset."""
    chosen = list(range(len(f_numbers)))
    for word in subset.split():
        if word.startswith("f/"):
            chosen = [i for i in chosen if f_numbers[i] == float(word[2:])]
        elif word == "half":
            chosen = chosen[::2]
        elif word == "few":
            # Neighbouring photographs are chosen, since six that are far apart would show no common surface.
            middle = max(0, (len(chosen) - FEW) // 2)
            chosen = chosen[middle : middle + FEW]
    return chosen


def _faded(view, contrast: float):
    return view if contrast == 1 else replace(view, image=(0.5 + contrast * (view.image - 0.5)).astype(np.float32))


def make_datasets(data: Path, work: Path, say: Callable[[str], None], only: str = "") -> None:
    """Make the datasets that the cases need and that don't exist yet.

    data: the folder of real scenes. only: names of scenes, comma-separated; without it, all.
    """
    wanted = set(filter(None, only.split(",")))
    for name, (layout, width) in REAL.items():
        if not wanted or name in wanted:
            make(
                MakeDataset(scene=str(data / name), out=work / name, photographs="shallow", layout=layout, width=width),
                Silent(),
            )
            say(name)
    tabletop = content_folder("datasets") / "tabletop"
    for name, width in WIDTHS.items():
        if not wanted or name in wanted:
            _through_lenses(
                tabletop if name == "tabletop" else data / name, work / name, LARGE, say, width=width, depth_steps=1200
            )
    for name in DEVELOPMENT:
        if not wanted or f"rendered_{name}" in wanted:
            scene = work / "scenes" / name
            if not scene.is_dir():
                make_scene(MakeScene(name, out=scene, views=12, width=192, height=144, samples=64, lens_views=0))
            _through_lenses(scene, work / f"rendered_{name}", SMALL, say)
    for name in THINLENS:
        if not wanted or f"thinlens_{name}" in wanted:
            _through_lenses(content_folder("datasets") / "thinlens" / name, work / f"thinlens_{name}", ("a1",), say)


def _through_lenses(scene: Path, out: Path, lenses: tuple[str, ...], say: Callable[[str], None], **options) -> None:
    first = None
    for lens in lenses:
        folder = make(MakeDataset(scene=str(scene), out=out / lens, **options, **LENSES[lens]), Silent(), sibling=first)
        first = first or folder
        say(f"{out.name}/{lens}")
