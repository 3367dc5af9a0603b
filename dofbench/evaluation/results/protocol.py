"""Protocols: named, versioned ways of scoring. Only results of one protocol may stand in one table."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from dofbench.core.errors import InputError
from dofbench.datasets.format.inputs import Inputs

AIF_PREFIX, PHOTO_PREFIX, ACROSS_PREFIX = "aif_", "photo_", "across_"
LENS_COLUMNS = ("delta_a", "delta_f", "delta_r")
DEPTH_COLUMNS = ("disparity_error", "depth_rel")
PHOTOGRAPH_COLUMNS = ("photo_psnr", "photo_ssim", "photo_blur_psnr")
# Predictions by the learned aperture scaled to the test photograph's f-number, by the aperture unscaled, and all in
# focus; scored over all pixels, and over the thirds in which the training photographs are most and least blurred.
ACROSS_COLUMNS = (
    "across_psnr",
    "across_ssim",
    "across_blurred_psnr",
    "across_clear_psnr",
    "unscaled_psnr",
    "unscaled_blurred_psnr",
    "in_focus_psnr",
    "in_focus_blurred_psnr",
)
EXIF_COLUMNS = ("exif_spread", "exif_ratio")
EXIF_FOCUS_COLUMNS = ("exif_focus", "exif_focus_scatter")
# Scores of predictions for comparison with those by the learned lens; a method without a lens has none of these.
OF_LENSES = ("photo_blur_psnr", "unscaled_psnr", "unscaled_blurred_psnr")
BY_BLUR = "photographs are predicted by one Gaussian blur in place of a lens"


@dataclass(frozen=True)
class Protocol:
    """How a result is scored. Any change is a new version with a new id.

    id: name and version. inputs: what the method trains on. split: what decides which views are test views. levels:
    number of levels to which predictions are rounded before scoring, as in a PNG. refocus: metrics of predictions
    rendered with the test view's true lens, against its shallow photograph. all_in_focus: metrics of predictions
    rendered without a lens, against the sharp original; their columns carry `aif_`. lens: errors of the learned lens,
    over the training views, in the units of the dataset's disparity range. depth: errors of the depth rendered at the
    test views, if the dataset's depth is exact. photograph: scores of test views that are photographs of unknown lens:
    lens and colours are fitted on half of each photograph and the other half is scored
    (`dofbench.evaluation.scoring.photographs`). mean: how the values of several images are averaged.
    """

    id: str
    inputs: Inputs
    split: str
    levels: int
    refocus: tuple[str, ...]
    all_in_focus: tuple[str, ...]
    lens: tuple[str, ...]
    mean: str
    depth: tuple[str, ...] = ()
    photograph: tuple[str, ...] = ()

    @property
    def refocus_columns(self) -> tuple[str, ...]:
        """Column ids of the refocus metrics."""
        return self.refocus

    @property
    def all_in_focus_columns(self) -> tuple[str, ...]:
        """Column ids of the all-in-focus metrics."""
        return tuple(AIF_PREFIX + metric for metric in self.all_in_focus)

    def as_data(self) -> dict[str, Any]:
        """The protocol as plain data, for the result."""
        return asdict(self)


_SHARED: dict[str, Any] = {
    "split": "the dataset's test views",
    "levels": 256,
    "refocus": ("psnr", "ssim", "ms_ssim", "flip", "gmsd", "delta_e"),
    "all_in_focus": ("psnr", "ssim", "flip"),
    "mean": "arithmetic mean of the per-image values",
}
# With SSIM as the authors of DoF-Gaussian measure it, beside their figures.
_WITH_THEIR_SSIM: dict[str, Any] = {
    **_SHARED,
    "refocus": (*_SHARED["refocus"], "ssim_uniform7"),
    "all_in_focus": (*_SHARED["all_in_focus"], "ssim_uniform7"),
}
PHOTOGRAPHS = Protocol(
    id="photographs-v1",
    inputs="shallow",
    lens=LENS_COLUMNS,
    depth=DEPTH_COLUMNS,
    photograph=PHOTOGRAPH_COLUMNS,
    **{**_SHARED, "refocus": (), "all_in_focus": ()},
)

# Sharp photographs contain no information about a lens, so protocols that train on them have no lens errors.
PROTOCOLS: dict[str, Protocol] = {
    protocol.id: protocol
    for protocol in (
        Protocol(id="refocus-v1", inputs="shallow", lens=LENS_COLUMNS, **_SHARED),
        Protocol(id="sharp-inputs-v1", inputs="all-in-focus", lens=(), **_SHARED),
        # With errors of the rendered depth.
        Protocol(id="refocus-v2", inputs="shallow", lens=LENS_COLUMNS, depth=DEPTH_COLUMNS, **_SHARED),
        Protocol(id="sharp-inputs-v2", inputs="all-in-focus", lens=(), depth=DEPTH_COLUMNS, **_SHARED),
        Protocol(id="refocus-v3", inputs="shallow", lens=LENS_COLUMNS, depth=DEPTH_COLUMNS, **_WITH_THEIR_SSIM),
        Protocol(id="sharp-inputs-v3", inputs="all-in-focus", lens=(), depth=DEPTH_COLUMNS, **_WITH_THEIR_SSIM),
        PHOTOGRAPHS,
        replace(PHOTOGRAPHS, id="across-apertures-v1", photograph=ACROSS_COLUMNS),
    )
}


def arithmetic_mean(values: Sequence[float]) -> float:
    """The mean of the values. It is NaN if a value is NaN, or if there are infinities of both signs: no value is left
    out.

    Raises ValueError without values.
    """
    if not values:
        raise ValueError("mean: expected at least one value, found none")
    try:
        return math.fsum(values) / len(values)
    except OverflowError:  # the sum alone is beyond float64
        return statistics.mean(values)  # by fractions
    except ValueError:  # infinities of both signs
        return math.nan


def protocol_for(inputs: Inputs, *, photographs: tuple[str, ...] = ()) -> Protocol:
    """The newest protocol for a method's inputs. Raises InputError for unknown inputs.

    photographs: the columns by which test views are scored that are photographs of unknown lens, none of them with a
    sharp image: `PHOTOGRAPH_COLUMNS`, or `ACROSS_COLUMNS` if they have another aperture than the training views.
    """
    found = [
        protocol
        for protocol in PROTOCOLS.values()
        if protocol.inputs == inputs and protocol.photograph == (photographs if inputs == "shallow" else ())
    ]
    if not found:
        known = dict.fromkeys(repr(protocol.inputs) for protocol in PROTOCOLS.values())
        raise InputError("inputs", repr(inputs), " or ".join(known))
    return found[-1]
