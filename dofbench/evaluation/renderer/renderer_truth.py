"""A photograph with a known lens, and the inputs of a renderer that is to reproduce it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.files import canonical_json, sha256_text


@dataclass(frozen=True, eq=False)
class Truth:
    """One photograph with optical blur.

    sharp, photograph: (H, W, 3) float32, encoded by the blur's gamma; the photograph is clipped to [0, 1], the sharp
    image isn't, so that highlights keep their brightness. signed_radius: (H, W) float32, pixels, positive nearer than
    the focus. blur: encoding and aperture shape of the photograph, with the scatter's defaults for the rest. border:
    pixels along the image's edges that only the region "frame" includes. own_error_db: PSNR of the photograph's own
    noise. thin_lens: renders the same photograph from the scene's geometry with a given number of lens points, encoded;
    None without geometry.
    """

    sharp: np.ndarray
    signed_radius: np.ndarray
    photograph: np.ndarray
    border: int
    own_error_db: float
    blur: Blur = Blur()
    thin_lens: Callable[[int], np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """A photograph that is rendered or read only when it is needed.

    source: kind of truth. name, view: the scene's name, and which of its views. aperture, focus: in the source's own
    units. content: plain data of everything that decides what `make` returns, with checksums for the content of files.
    megapixels: size of the photograph. geometry: whether the truth will have a `thin_lens`.
    """

    source: str
    name: str
    aperture: float
    focus: float
    content: object
    megapixels: float
    make: Callable[[], Truth]
    view: str = ""
    geometry: bool = False

    @property
    def key(self) -> str:
        """A hash of the content, which differs for any two different cases."""
        return sha256_text(canonical_json([self.source, self.name, self.view, self.aperture, self.focus, self.content]))

    @property
    def title(self) -> str:
        """Description for progress messages."""
        scene = f"{self.source}, {self.name}" + (f" {self.view}" if self.view else "")
        return f"{scene}, aperture {self.aperture:.4g}, focus {self.focus:.4g}"
