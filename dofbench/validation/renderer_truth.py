"""A photograph with a known lens, and what a renderer is given to make the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.files import canonical_json, sha256_text


@dataclass(frozen=True, eq=False)
class Truth:
    """One photograph with optical blur.

    sharp, photograph: (H, W, 3) float32, encoded by the blur's gamma; the photograph is clipped to [0, 1], what a
    renderer gets is not, so that a highlight stays as bright as it is. signed_radius: (H, W) float32, pixels, positive
    nearer than the focus. blur: encoding and aperture's shape of the photograph, and else what the scatter takes unless
    told. border: pixels along the image's edges that only the region "frame" counts. own_error_db: PSNR of the
    photograph's own noise. thin_lens: the same photograph from so many points of the lens, by the scene's geometry,
    encoded; None where there is no geometry.
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
    """A photograph that is made, or read, when its turn comes.

    source: what kind of truth. name, view: the scene's, and of several views the one. aperture, focus: in the source's
    own units. content: all that decides what `make` returns, as plain data; what files hold by their checksums.
    megapixels: of the photograph. geometry: whether the truth will have a `thin_lens`.
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
        """Tells apart what differs in any way: a hash of the content."""
        return sha256_text(canonical_json([self.source, self.name, self.view, self.aperture, self.focus, self.content]))

    @property
    def title(self) -> str:
        """For people."""
        scene = f"{self.source}, {self.name}" + (f" {self.view}" if self.view else "")
        return f"{scene}, aperture {self.aperture:.4g}, focus {self.focus:.4g}"
