"""Protocols: named, versioned ways of scoring. Only results of one protocol are compared in a table."""

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
# Shares of test views without a fitted lens and with one at its bound, and of pixels that training views cover, %.
_FIT_COLUMNS = ("photo_no_lens", "photo_at_bound", "photo_covered")
# Errors of band energies: mean magnitude and mean by the fitted lens, mean magnitude by the all-in-focus rendering.
PICTURE_BLUR = ("photo_blur", "photo_blur_bias")
BLUR_COLUMNS = (*PICTURE_BLUR, "photo_sharp_blur")
PHOTOGRAPH_COLUMNS = (
    *("photo_psnr", "photo_ssim", "photo_sharp_psnr", "photo_sharp_ssim"),
    *_FIT_COLUMNS,
    *BLUR_COLUMNS,  # last, because the protocol had none at first
)
_PHOTOGRAPH_COLUMNS_1 = ("photo_psnr", "photo_ssim", "photo_blur_psnr")
# Predictions by the learned aperture scaled to the test view's f-number, by the unscaled aperture, and all in focus;
# over all pixels, and over the thirds in which the training views are most and least blurred.
_ACROSS_COLUMNS_1 = (
    *("across_psnr", "across_ssim", "across_blurred_psnr", "across_clear_psnr"),
    *("unscaled_psnr", "unscaled_blurred_psnr", "in_focus_psnr", "in_focus_blurred_psnr"),
)
ACROSS_COLUMNS = (*_ACROSS_COLUMNS_1, *_FIT_COLUMNS)
# Of one run on photographs: PSNR of training photographs; the shares of `scoring/photographs/lens_evidence.py`.
FIT_CEILING = "photo_fit_psnr"
EVIDENCE_COLUMNS = ("lens_energy", "lens_seen")
EXIF_COLUMNS = ("exif_spread", "exif_ratio")
EXIF_FOCUS_COLUMNS = ("exif_focus", "exif_focus_scatter")
# Scores for comparison with the learned lens; a method without a lens has none of these.
OF_LENSES = ("unscaled_psnr", "unscaled_blurred_psnr", "photo_no_lens", "photo_at_bound")
WITHOUT_LENS = "test views are predicted without a lens"


@dataclass(frozen=True)
class Protocol:
    """How a result is scored. Any change is a new version with a new id.

    inputs: training images. split: which views are test views. levels: to which predictions are rounded before scoring.
    refocus: metrics of renderings with the test view's true lens. all_in_focus: metrics of renderings without a lens,
    against the all-in-focus image; columns with `aif_`. lens: errors of the learned lens over the training views.
    depth: errors of the rendered depth at the test views, if the dataset's depth is exact. photograph: scores of test
    views that are real photographs of unknown lens (`dofbench.evaluation.scoring.photographs`). mean: over several
    images.
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

    @property
    def image_columns(self) -> tuple[str, ...]:
        """Column ids of scores of images, real photographs included."""
        return *self.refocus_columns, *self.all_in_focus_columns, *self.photograph

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
# With SSIM as DoF-Gaussian's script measures it, for comparison with published scores.
_WITH_THEIR_SSIM: dict[str, Any] = {
    **_SHARED,
    "refocus": (*_SHARED["refocus"], "ssim_uniform7"),
    "all_in_focus": (*_SHARED["all_in_focus"], "ssim_uniform7"),
}
_PHOTOGRAPHS = Protocol(
    id="photographs-v2",
    inputs="shallow",
    lens=LENS_COLUMNS,
    depth=DEPTH_COLUMNS,
    photograph=PHOTOGRAPH_COLUMNS,
    **{**_SHARED, "refocus": (), "all_in_focus": ()},
)

# All-in-focus images contain no information about a lens, so protocols that train on them have no lens errors.
PROTOCOLS: dict[str, Protocol] = {
    protocol.id: protocol
    for protocol in (
        Protocol(id="refocus-v1", inputs="shallow", lens=LENS_COLUMNS, **_SHARED),
        Protocol(id="sharp-inputs-v1", inputs="all-in-focus", lens=(), **_SHARED),
        Protocol(id="refocus-v2", inputs="shallow", lens=LENS_COLUMNS, depth=DEPTH_COLUMNS, **_SHARED),
        Protocol(id="sharp-inputs-v2", inputs="all-in-focus", lens=(), depth=DEPTH_COLUMNS, **_SHARED),
        Protocol(id="refocus-v3", inputs="shallow", lens=LENS_COLUMNS, depth=DEPTH_COLUMNS, **_WITH_THEIR_SSIM),
        Protocol(id="sharp-inputs-v3", inputs="all-in-focus", lens=(), depth=DEPTH_COLUMNS, **_WITH_THEIR_SSIM),
        replace(_PHOTOGRAPHS, id="photographs-v1", photograph=_PHOTOGRAPH_COLUMNS_1),
        replace(_PHOTOGRAPHS, id="across-apertures-v1", photograph=_ACROSS_COLUMNS_1),
        _PHOTOGRAPHS,
        replace(_PHOTOGRAPHS, id="across-apertures-v2", photograph=ACROSS_COLUMNS),
    )
}


def kind_prefix(column: str) -> str:
    """The prefix of a score of images, which says what the images are; "" for refocused views."""
    return next((one for one in (AIF_PREFIX, PHOTO_PREFIX, ACROSS_PREFIX) if column.startswith(one)), "")


def scores_both_halves(protocol: str) -> bool:
    """Whether the protocol of this id fits each half of a photograph and scores the other, as in the first version."""
    return protocol in PROTOCOLS and PROTOCOLS[protocol].photograph in (_PHOTOGRAPH_COLUMNS_1, _ACROSS_COLUMNS_1)


def arithmetic_mean(values: Sequence[float]) -> float:
    """The mean of the values; NaN for a NaN or infinities of both signs. Raises ValueError without values."""
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

    photographs: columns for test views of unknown lens without an all-in-focus image: `PHOTOGRAPH_COLUMNS`, or
    `ACROSS_COLUMNS` if their aperture differs from the training views'.
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
