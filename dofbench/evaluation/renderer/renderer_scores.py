"""Scores of a rendering against an image with optical blur, by region; and their storage."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from dofbench.core.files import read_json, sha256_text, write_json
from dofbench.core.similarity import ssim_map
from dofbench.core.source_digest import SCORED, package_digest
from dofbench.evaluation.metrics.flip import flip_map
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.evaluation.renderer.variants import Variant
from dofbench.optics.depth_edges import near_depth_edges

REGIONS = ("all", "in focus", "blurred", "depth edge", "frame")
FOLDER = ".scores"
_NAME = re.compile(r"[0-9a-f]{16}-[0-9a-f]{24}\.json")
_SHARP = 0.5  # pixels, radius below which blur is invisible
_LEAST_PIXELS = 200  # fewest pixels of a region that is scored
_TIMED = 3  # timed calls of a renderer, of which the median is taken
_ENOUGH_SECONDS = 1.0  # a slower renderer is timed once
_called: set[str] = set()


@dataclass(frozen=True)
class Score:
    """One row of renderer.csv.

    aperture, focus: in the source's units. radius: largest CoC radius, pixels. seconds_per_megapixel: of one rendering.
    truth_psnr: of the image's own noise, dB; NaN if unknown.
    """

    source: str
    name: str
    view: str
    aperture: float
    focus: float
    radius: float
    variant: str
    region: str
    pixels: int
    psnr: float
    ssim: float
    flip: float
    seconds_per_megapixel: float
    truth_psnr: float


def regions(signed_radius: np.ndarray, border: int) -> dict[str, np.ndarray]:
    """(H, W) masks by name. signed_radius: (H, W) pixels. All but "frame" exclude `border` pixels at the image's edges.

    "depth edge": within one CoC radius (the larger of both sides) of a depth edge; "in focus" and "blurred" are the
    other pixels.
    """
    near_edge = near_depth_edges(signed_radius)
    inside = np.zeros(signed_radius.shape, dtype=bool)
    inside[border : -border or None, border : -border or None] = True
    sharp = np.abs(signed_radius) <= _SHARP
    return {
        "all": inside,
        "in focus": inside & ~near_edge & sharp,
        "blurred": inside & ~near_edge & ~sharp,
        "depth edge": inside & near_edge,
        "frame": np.ones(signed_radius.shape, dtype=bool),
    }


def score(case: Case, truth: Truth, variant: Variant) -> tuple[list[Score], np.ndarray]:
    """A variant's scores by region, and its rendering, (H, W, 3) in [0, 1]."""
    image, seconds = _timed(variant, truth)
    image = np.clip(image, 0, 1).astype(np.float32)
    squared = ((image - truth.photograph).astype(np.float64) ** 2).mean(axis=2)
    similar = np.full(squared.shape, np.nan)
    similar[5:-5, 5:-5] = ssim_map(image, truth.photograph).mean(axis=2)
    visible = flip_map(image, truth.photograph)
    rows = []
    for region, mask in regions(truth.signed_radius, truth.border).items():
        pixels = int(mask.sum())
        if pixels < _LEAST_PIXELS:
            continue
        error = squared[mask].mean()
        rows.append(
            Score(
                **{key: getattr(case, key) for key in ("source", "name", "view", "aperture", "focus")},
                radius=float(np.abs(truth.signed_radius).max()),
                variant=variant.name,
                region=region,
                pixels=pixels,
                psnr=-10 * math.log10(error) if error > 0 else math.inf,
                ssim=float(np.nanmean(similar[mask])),
                flip=float(visible[mask].mean(dtype=np.float64)),
                seconds_per_megapixel=seconds / (squared.size / 1e6),
                truth_psnr=truth.own_error_db,
            )
        )
    return rows, image


def _timed(variant: Variant, truth: Truth) -> tuple[np.ndarray, float]:
    if variant.name not in _called:
        variant.render(truth)  # the first call may compile
        _called.add(variant.name)
    seconds: list[float] = []
    while len(seconds) < _TIMED and sum(seconds) < _ENOUGH_SECONDS:
        start = perf_counter()
        image = variant.render(truth)
        seconds.append(perf_counter() - start)
    return image, median(seconds)


class Store:
    """The scores in a folder, by image and variant: one file per image, named by hashes of code and content.

    Scores of other code are removed.
    """

    def __init__(self, out: Path):
        self._folder, self._code = out / FOLDER, package_digest((*SCORED, "evaluation/renderer"))
        for file in self._folder.glob("*.json"):
            if _NAME.fullmatch(file.name) and not file.name.startswith(self._code[:16]):
                file.unlink()

    def read(self, case: Case) -> dict[str, list[Score]]:
        """The scores of each variant; empty without scores or for a damaged file."""
        try:
            kept = read_json(self._file(case))
            return {name: [Score(**row) for row in rows] for name, rows in kept.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}

    def write(self, case: Case, rows: dict[str, list[Score]]) -> None:
        """Write the scores of an image's variants, atomically."""
        write_json(self._file(case), {name: [asdict(row) for row in of_one] for name, of_one in rows.items()})

    def _file(self, case: Case) -> Path:
        return self._folder / f"{self._code[:16]}-{sha256_text(case.key)[:24]}.json"
