"""An image with optical blur by a known lens, and the inputs of a renderer that is to reproduce it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, sha256_text
from dofbench.optics.tone import encode


@dataclass(frozen=True, eq=False)
class Truth:
    """One image with optical blur.

    sharp, photograph: (H, W, 3) float32, encoded by the blur's gamma; only the photograph is clipped to [0, 1], so the
    all-in-focus image keeps its highlights. signed_radius: (H, W) float32, pixels, positive nearer than the focus.
    blur: gamma and aperture shape. border: pixels along the edges that only the region "frame" includes.
    own_error_db: PSNR of the photograph's own noise. thin_lens: renders the photograph from the scene's geometry with a
    number of aperture samples, encoded; None without geometry.
    """

    sharp: np.ndarray
    signed_radius: np.ndarray
    photograph: np.ndarray
    border: int
    own_error_db: float
    blur: Blur = Blur()
    thin_lens: Callable[[int], np.ndarray] | None = None

    @staticmethod
    def from_linear(
        sharp: np.ndarray,
        photograph: np.ndarray,
        signed_radius: np.ndarray,
        own_error_db: float = math.nan,
        thin_lens: Callable[[int], np.ndarray] | None = None,
    ) -> Truth:
        """The truth from images of linear light, with a border as wide as the largest radius."""
        return Truth(
            sharp=encode(np.maximum(sharp, 0)),
            signed_radius=signed_radius,
            photograph=encode(np.clip(photograph, 0, 1)),
            border=math.ceil(float(np.abs(signed_radius).max())) + 2,
            own_error_db=own_error_db,
            thin_lens=thin_lens,
        )


@dataclass(frozen=True, eq=False)
class Case:
    """An image that is rendered or read when it is needed.

    source: kind of truth. name, view: of the scene. aperture, focus: in the source's own units. content: plain data
    that decides what `make` returns, with checksums of files. geometry: whether the truth will have a `thin_lens`.
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
        """A hash of the content."""
        return sha256_text(canonical_json([self.source, self.name, self.view, self.aperture, self.focus, self.content]))

    @property
    def title(self) -> str:
        """Description for progress messages."""
        scene = f"{self.source}, {self.name}" + (f" {self.view}" if self.view else "")
        return f"{scene}, aperture {self.aperture:.4g}, focus {self.focus:.4g}"


def existing(path: Path, expected: str) -> Path:
    """The path of a file. Raises InputError if there is none."""
    if not path.is_file():
        raise InputError(path, "nothing", expected)
    return path
