"""Colour difference CIEDE2000.

Source: Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula", Color Research and
Application 2005; computed by colour-science.
"""

from __future__ import annotations

import numpy as np

from dofbench.core.similarity import checked, unmasked, valid_mean


def delta_e(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean CIEDE2000 over the pixels; 0 is best, about 1 is just noticeable, 100 is black on white.

    An encoded image is taken as what a display shows: sRGB primaries and transfer function
    (IEC 61966-2-1), white D65, 2 degree observer, whatever power the dataset was encoded with.
    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes that don't
    fit.
    """
    import colour

    one, other = (colour.XYZ_to_Lab(colour.sRGB_to_XYZ(image)) for image in checked(*unmasked(prediction, truth, mask)))
    return valid_mean(colour.difference.delta_E_CIE2000(one, other), mask)
