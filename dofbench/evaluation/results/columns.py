"""The leaderboard's columns: their labels, units, whether higher is better, and how many digits are meaningful."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dofbench.evaluation.metrics import METRICS
from dofbench.evaluation.results.protocol import (
    ACROSS_COLUMNS,
    AIF_PREFIX,
    EXIF_COLUMNS,
    EXIF_FOCUS_COLUMNS,
    PHOTOGRAPH_COLUMNS,
)

IDENTITY = ("method", "preset", "dataset", "scene", "protocol", "seed", "status")
# What a run's scores are evidence of, last in files: the role of its scene, what took the photographs, whether its
# preset was frozen
STANDING = ("role", "photographer", "frozen")
REFOCUS = ("psnr", "ssim", "ms_ssim", "flip", "gmsd", "delta_e", "ssim_uniform7")
ALL_IN_FOCUS = ("aif_psnr", "aif_ssim", "aif_flip", "aif_ssim_uniform7")
LENS = ("delta_a", "delta_f", "delta_r")
DEPTH = ("disparity_error", "depth_rel")
PHOTOGRAPH = (*PHOTOGRAPH_COLUMNS, *ACROSS_COLUMNS)
EXIF = (*EXIF_COLUMNS, *EXIF_FOCUS_COLUMNS)
COST = ("train_s", "train_cpu_s", "cold_start_s", "steps", "render_fps", "peak_mb", "gaussians", "resolved")
SCORES = (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH, *LENS, *EXIF, *DEPTH, *COST)
# Columns added later, which come last in files
_NEW_IN_FILES = (
    *DEPTH,
    "train_cpu_s",
    "cold_start_s",
    *PHOTOGRAPH,
    *EXIF_COLUMNS,
    "resolved",
    "ssim_uniform7",
    "aif_ssim_uniform7",
    *EXIF_FOCUS_COLUMNS,
)
FILE_SCORES = (*(column for column in SCORES if column not in _NEW_IN_FILES), *_NEW_IN_FILES)

_DIGITS = {
    "psnr": 2,
    "ssim": 4,
    "ssim_uniform7": 4,
    "ms_ssim": 4,
    "flip": 4,
    "gmsd": 4,
    "delta_e": 3,
    "delta_a": 3,
    "delta_f": 3,
    "delta_r": 3,
    "disparity_error": 4,
    "depth_rel": 4,
    "train_s": 1,
    "train_cpu_s": 1,
    "cold_start_s": 1,
    "steps": 0,
    "render_fps": 1,
    "peak_mb": 0,
    "gaussians": 0,
    "photo_psnr": 2,
    "photo_ssim": 4,
    "photo_blur_psnr": 2,
    "exif_spread": 1,
    "exif_ratio": 1,
    "exif_focus": 2,
    "exif_focus_scatter": 1,
    "resolved": 0,
}
_COSTS = {
    "train_s": ("training", "s", None, "wall time of training, evaluation and cold start excluded"),
    "train_cpu_s": ("training, CPU", "s", None, "processor time of the same, over all threads"),
    "cold_start_s": (
        "cold start",
        "s",
        None,
        "wall time of imports and of a first step that isn't counted as "
        "training; a minute where kernels had to be compiled, seconds where their code lay on disk",
    ),
    "steps": ("steps", "", None, "training steps taken"),
    "render_fps": ("rendering", "frames/s", True, "1 / median time of rendering a test view without a lens"),
    "peak_mb": ("peak memory", "MB", None, "largest resident memory of the whole process, 10^6 bytes"),
    "gaussians": ("Gaussians", "", None, "at the end of training"),
    "resolved": (
        "resolved",
        "%",
        None,
        "of the test views' pixels: some training photograph saw their surface through "
        "a circle of confusion of at most 1 px radius, by the learned depth and lenses; the rest of an "
        "all-in-focus rendering is one of many that explain the photographs",
    ),
}


_HALVES = (
    "of held-out photographs: fitted on half of the tiles, scored on the other half, and the other way round; "
    "colours by an affine map fitted likewise"
)
# column -> (label, unit, whether higher is better, note)
_PHOTOGRAPHS = {
    "photo_psnr": (
        "photograph PSNR",
        "dB",
        True,
        f"{_HALVES}; fitted are aperture and focus, or of a method without a "
        "lens one Gaussian blur. Along the curve of up to 4 test views, by a shorter search",
    ),
    "photo_ssim": ("photograph SSIM", "", True, f"of the same, over windows within a tile; {_HALVES}"),
    "photo_blur_psnr": (
        "photograph PSNR by one blur",
        "dB",
        True,
        f"{_HALVES}; of the rendering without a lens by one Gaussian blur: what the lens is worth beyond blurring",
    ),
}
_OTHER_APERTURE = "photographs of an f-number that no training view has"
_BLURRED = (
    "over the third of each view's scored pixels in which the training photographs are most blurred against "
    "the test photographs, told by gradients around the sparse points in both"
)
_PHOTOGRAPHS |= {
    "across_psnr": (
        "other aperture, PSNR",
        "dB",
        True,
        f"{_OTHER_APERTURE}, by the learned aperture (median over the "
        f"training views) times the ratio of the f-numbers, {_HALVES}: the focus, or of a method without a "
        "lens one Gaussian blur",
    ),
    "across_ssim": ("other aperture, SSIM", "", True, "of the same, over windows within a tile"),
    "across_blurred_psnr": ("other aperture, PSNR where blurred", "dB", True, f"of the same, {_BLURRED}"),
    "across_clear_psnr": (
        "other aperture, PSNR where clear",
        "dB",
        True,
        "of the same, over the third that is least so",
    ),
    "unscaled_psnr": ("aperture unchanged, PSNR", "dB", True, f"{_OTHER_APERTURE}, by the learned aperture as it is"),
    "unscaled_blurred_psnr": ("aperture unchanged, PSNR where blurred", "dB", True, f"of the same, {_BLURRED}"),
    "in_focus_psnr": (
        "no aperture, PSNR",
        "dB",
        True,
        f"{_OTHER_APERTURE}, by a rendering without a lens, colours fitted alone",
    ),
    "in_focus_blurred_psnr": ("no aperture, PSNR where blurred", "dB", True, f"of the same, {_BLURRED}"),
}


@dataclass(frozen=True)
class Column:
    """One column. higher_is_better: None if neither direction is better by itself. note: how the score is measured."""

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
    metric = column.removeprefix(AIF_PREFIX)
    digits = _DIGITS.get(metric, 4)
    if column in _COSTS:
        label, unit, higher_is_better, note = _COSTS[column]
        return Column(column, label, unit, higher_is_better, digits, note)
    if column in _PHOTOGRAPHS:
        label, unit, higher_is_better, note = _PHOTOGRAPHS[column]
        return Column(column, label, unit, higher_is_better, 4 if column.endswith("ssim") else 2, note)
    entry = METRICS[metric]
    label, note = entry.label, entry.note
    if column.startswith(AIF_PREFIX):
        label, note = f"all-in-focus {label}", f"{label} of a rendering without a lens against the sharp original"
    elif entry.needs == "images":
        note = f"of a rendering through the test view's true lens against its shallow photograph; {note}"
    return Column(column, label, entry.unit, entry.higher_is_better, digits, note)


# Columns that `dofbench score` can add to those that every run measures.
_ADDABLE = tuple(
    prefix + metric.id
    for prefix in ("", AIF_PREFIX)
    for metric in METRICS.values()
    if metric.needs == "images" and prefix + metric.id not in SCORES
)
COLUMNS: dict[str, Column] = {column: _column(column) for column in (*SCORES, *_ADDABLE)}
