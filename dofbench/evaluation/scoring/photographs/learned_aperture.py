"""The aperture that a method predicts a held-out photograph with: learned from the training views, scaled by EXIF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import PhysicalLens
from dofbench.datasets.format.benchmark_dataset import BenchmarkView


def learned_aperture(
    learned: Mapping[str, PhysicalLens] | None,
    training: Sequence[BenchmarkView],
    view: BenchmarkView,
    *,
    by_exif: bool = True,
) -> float | None:
    """The median learned aperture on the view's camera, pixels * scene unit; None without learned lenses.

    The opening is the focal length over the f-number. Where EXIF has both views' f-numbers, a training view's opening
    is scaled by their ratio, and by the ratio of focal lengths where both are known. If some training views have an
    f-number and the view has one, only those count. by_exif: False for openings as learned.
    """
    if not learned:
        return None
    scaled, plain = [], []
    for one in training:
        if one.name not in learned:
            continue
        aperture = learned[one.name].transferred(one.camera, view.camera).aperture
        plain.append(aperture)
        if by_exif and (ratio := _ratio(one.exif, view.exif)) is not None:
            scaled.append(aperture * ratio)
    return float(np.median(scaled or plain))


def _ratio(of: Exif | None, to: Exif | None) -> float | None:
    """The opening of a view over another's by their EXIF; None without both f-numbers."""
    if of is None or to is None or of.f_number is None or to.f_number is None:
        return None
    lengths = to.focal_length / of.focal_length if to.focal_length and of.focal_length else 1.0
    return lengths * of.f_number / to.f_number
