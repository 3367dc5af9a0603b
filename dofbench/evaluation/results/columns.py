"""The leaderboard's columns: label, unit, direction, digits. Their texts are in columns.toml."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from dofbench.evaluation.metrics import COLUMN_DATA, METRICS
from dofbench.evaluation.results.protocol import (
    ACROSS_COLUMNS,
    ACROSS_PREFIX,
    AIF_PREFIX,
    BLUR_COLUMNS,
    EVIDENCE_COLUMNS,
    EXIF_COLUMNS,
    EXIF_FOCUS_COLUMNS,
    FIT_CEILING,
    PHOTO_PREFIX,
    PHOTOGRAPH_COLUMNS,
    kind_prefix,
)

IDENTITY = ("method", "preset", "dataset", "scene", "protocol", "seed", "status")
# Last in files: the role of the scene, the source of the defocus, whether the preset was fixed before
STANDING = ("role", "photographer", "frozen")
REFOCUS = ("psnr", "ssim", "ms_ssim", "flip", "gmsd", "delta_e", "ssim_uniform7")
ALL_IN_FOCUS = ("aif_psnr", "aif_ssim", "aif_flip", "aif_ssim_uniform7")
LENS = ("delta_a", "delta_f", "delta_r")
DEPTH = ("disparity_error", "depth_rel")
PHOTOGRAPH = tuple(dict.fromkeys((*PHOTOGRAPH_COLUMNS, "photo_blur_psnr", *ACROSS_COLUMNS)))
_PHOTOGRAPHS_2 = (
    *("photo_sharp_psnr", "photo_sharp_ssim", "photo_no_lens", "photo_at_bound", "photo_covered"),
    *BLUR_COLUMNS,
)
OF_PHOTOGRAPH_RUNS = (FIT_CEILING, *EVIDENCE_COLUMNS)
HELD_OUT_SCORES = ("held_out_psnr", "held_out_ssim")  # of pixels of the training views, where a run held some out
EXIF = (*EXIF_COLUMNS, *EXIF_FOCUS_COLUMNS)
COST = ("train_s", "train_cpu_s", "cold_start_s", "steps", "render_fps", "peak_mb", "gaussians", "resolved")
SCORES = (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH, *OF_PHOTOGRAPH_RUNS, *LENS, *EXIF, *DEPTH, *HELD_OUT_SCORES, *COST)
# Columns added later, which come last in files
_NEW_IN_FILES = (
    *(*DEPTH, "train_cpu_s", "cold_start_s", *(one for one in PHOTOGRAPH if one not in _PHOTOGRAPHS_2), *EXIF_COLUMNS),
    *("resolved", "ssim_uniform7", "aif_ssim_uniform7", *EXIF_FOCUS_COLUMNS, *_PHOTOGRAPHS_2),
    *(*OF_PHOTOGRAPH_RUNS, *HELD_OUT_SCORES),
)
FILE_SCORES = (*(column for column in SCORES if column not in _NEW_IN_FILES), *_NEW_IN_FILES)
# Columns of the files with a row for every view
PER_VIEW = (
    *(*"method preset dataset scene protocol seed view split".split(), *REFOCUS, *ALL_IN_FOCUS),
    *(*"aperture aperture_estimated focus focus_estimated".split(), *LENS, *DEPTH, *PHOTOGRAPH),
)


@dataclass(frozen=True)
class Column:
    """One column. higher_is_better: None if neither direction is better by itself. note: footnote of a table."""

    id: str
    label: str
    unit: str
    higher_is_better: bool | None
    digits: int
    note: str

    @property
    def heading(self) -> str:
        """Label with unit and an arrow: up if higher is better, down if lower is."""
        arrow = {True: " ↑", False: " ↓", None: ""}[self.higher_is_better]
        return self.label + (f" [{self.unit}]" if self.unit else "") + arrow

    def text(self, value: float) -> str:
        """The value, rounded; NaN and infinities by name."""
        return f"{value:.{self.digits}f}" if math.isfinite(value) else str(value)

    def best(self, values: list[float]) -> str | None:
        """The best of several values, in the form of `text`; None if there is no best value."""
        finite = [value for value in values if not math.isnan(value)]
        if self.higher_is_better is None or len(finite) < 2:
            return None
        return self.text(max(finite) if self.higher_is_better else min(finite))


def _column(column: str) -> Column:
    if column in COLUMN_DATA["columns"]:
        label, unit, direction, digits, note = COLUMN_DATA["columns"][column]
        higher_is_better = {"higher": True, "lower": False, "": None}[direction]
        return Column(column, label, unit, higher_is_better, digits, note.format(**COLUMN_DATA["parts"]))
    prefix = kind_prefix(column)
    entry = METRICS[column.removeprefix(prefix)]
    label, note = entry.label, entry.note
    if prefix == AIF_PREFIX:
        label, note = f"all-in-focus {label}", f"{label} of a rendering without a lens against the all-in-focus image"
    elif prefix:
        as_psnr = {PHOTO_PREFIX: "photograph", ACROSS_PREFIX: "other aperture,"}[prefix]
        label, note = f"{as_psnr} {label}", f"as {as_psnr} PSNR, over the whole image; {note}"
    elif entry.needs in ("images", "weights"):
        note = f"of a rendering with the test view's true lens against its image with shallow depth of field; {note}"
    return Column(column, label, entry.unit, entry.higher_is_better, entry.digits, note)


# Columns that `dofbench score` can add to those that every run measures.
_ADDABLE = tuple(
    prefix + metric.id
    for prefix in ("", AIF_PREFIX)
    for metric in METRICS.values()
    if metric.needs == "images" and prefix + metric.id not in SCORES
)
# Columns of metrics by a user's weights, which it adds where they are given.
WEIGHTED = tuple(
    prefix + metric.id
    for prefix in ("", AIF_PREFIX, PHOTO_PREFIX, ACROSS_PREFIX)
    for metric in METRICS.values()
    if metric.needs == "weights"
)
COLUMNS: dict[str, Column] = {column: _column(column) for column in (*SCORES, *_ADDABLE, *WEIGHTED)}


# ---- lenses as text ----

HELD_OUT = "held-out"
_LISTED = 6  # largest number of values that are listed; more are given as a range


def lens_words(lenses: dict[str, Any]) -> str:
    """A text such as "trained on F 0.2, 0.8 and A 0.5, 1; the test views ask for F 0.5 and A 0".

    lenses: of a run's plan; None for a view of unknown lens.
    """
    asked = "no test views"
    if lenses["test"]:
        known = any(lens is not None for lens in lenses["test"].values())
        asked = f"the test views ask for {_values(lenses['test'])}" if known else "no test lens"
    return f"trained on {_values(lenses['train'])}; {asked}"


def _values(views: dict[str, list[float] | None]) -> str:
    known = [lens for lens in views.values() if lens is not None]
    if not known:
        return "unknown lenses"
    apertures, focuses = zip(*known, strict=True)
    others = len(views) - len(known)
    return f"F {_listed(set(focuses))} and A {_listed(set(apertures))}" + (
        f" ({others} of {len(views)} lenses unknown)" if others else ""
    )


def _listed(values: set[float]) -> str:
    ordered = sorted(values)
    if len(ordered) > _LISTED:
        return f"{ordered[0]:g} to {ordered[-1]:g}"
    return ", ".join(f"{value:g}" for value in ordered)
