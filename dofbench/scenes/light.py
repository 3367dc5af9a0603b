"""Images of linear light in scenes: read, encoded for display where that is needed, and named in notes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import USUAL, Coding
from dofbench.core.images import read_coded
from dofbench.core.lens import GAMMA
from dofbench.optics.tone import encode

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of sRGB's primaries (IEC 61966-2-1)
_NOISE = 0.01  # of white; the noise of a camera's black level is below this


def read_values(file: Path, *, linear: bool) -> np.ndarray:
    """An image's values, (H, W, 3) float32: light, not negative and perhaps above 1; or encoded.

    linear: what `coding_of` said of the file. Raises InputError for a file that has changed since, for light that is
    not finite, and for pixels of negative luminance, which no colour has. Single channels may be negative, in colours
    outside the gamut; they count as 0.
    """
    values, coding = read_coded(file)
    if coding.linear is not linear:
        raise InputError(file, f"an image in {coding.name}", "the colour space that it had when it was found")
    if not linear:
        return values
    wrong = int((~np.isfinite(values)).any(axis=2).sum())
    if wrong:
        raise InputError(file, f"light that is not finite in {wrong} pixels", "a finite number for every pixel")
    dark = int((values @ _LUMINANCE < -_NOISE).sum())
    if dark:
        raise InputError(file, f"light of negative luminance in {dark} pixels", "0 or more, but for noise around black")
    return np.maximum(values, np.float32(0.0))


def for_display(light: np.ndarray, gamma: float = GAMMA) -> np.ndarray:
    """Linear light as an encoded image in [0, 1], by the pure power; what is brighter than 1 is clipped. float32."""
    return encode(np.clip(light, 0.0, 1.0), gamma).astype(np.float32)


def clipped_pixels(light: np.ndarray) -> int:
    """Pixels of linear light with a channel above 1, which `for_display` clips."""
    return int((light > 1.0).any(axis=2).sum())


def coding_notes(codings: Mapping[str, Coding]) -> list[str]:
    """A sentence for every colour space other than sRGB among a scene's images. codings: by image."""
    count = len(codings)
    notes = []
    for coding, number in Counter(codings.values()).items():
        what = f"{number} of {count} images are in {coding.name}"
        if coding.linear:
            notes.append(
                f"{what}: kept as light for blur, else encoded as light ** (1 / {GAMMA:g}) and clipped at 1"
                f"{'' if coding.is_usual else '; converted to the primaries of sRGB'}"
            )
        elif coding != USUAL:
            notes.append(f"{what}: converted to sRGB")
    return notes
