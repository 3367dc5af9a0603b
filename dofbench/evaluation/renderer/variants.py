"""The compared renderers, with their options."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dofbench.core.images import from_8bit, to_8bit
from dofbench.core.lens import ApertureShape
from dofbench.evaluation.renderer.lens_points import polygon_to_disc
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.optics.defocus import defocus_by_radius


@dataclass(frozen=True)
class Variant:
    """A renderer with its options.

    render: returns (H, W, 3), encoded like the photograph. family, knob: renderers of one family differ in the number
    `knob`, which trades time for precision. geometry: whether the scene's geometry is needed.
    """

    name: str
    render: Callable[[Truth], np.ndarray]
    family: str | None = None
    knob: int = 0
    geometry: bool = False

    def can_render(self, case: Case) -> bool:
        """Whether the image provides the inputs of this renderer."""
        return not self.geometry or case.geometry


def _render(truth: Truth, **changes: Any) -> np.ndarray:
    return defocus_by_radius(truth.sharp, truth.signed_radius, replace(truth.blur, **changes))[0]


def _other_shape(truth: Truth) -> np.ndarray:
    """Blur by another aperture of the same area: a hexagon instead of a disc, a disc instead of any other shape."""
    shape = truth.blur.shape
    other = ApertureShape(6) if shape.is_disc else ApertureShape()
    grown = truth.signed_radius * (polygon_to_disc(shape) / polygon_to_disc(other))
    return defocus_by_radius(truth.sharp, grown, replace(truth.blur, shape=other))[0]


def _of_8_bits(truth: Truth, **changes: Any) -> np.ndarray:
    """Blur the all-in-focus image as stored in a PNG: 256 levels, nothing above white."""
    return _render(replace(truth, sharp=from_8bit(to_8bit(truth.sharp))), **changes)


def _thin_lens(truth: Truth, samples: int) -> np.ndarray:
    assert truth.thin_lens is not None
    return truth.thin_lens(samples)


LAYERS = (4, 8, 16, 32)
SAMPLES = (16, 64, 256)

VARIANTS: tuple[Variant, ...] = (
    Variant("no blur", lambda truth: truth.sharp),
    Variant("scatter", _render, "scatter"),
    Variant("scatter, algorithm1 (no area term)", partial(_render, energy="algorithm1")),
    Variant("scatter, gamma 1", partial(_render, gamma=1.0)),
    Variant("scatter, gamma 2", partial(_render, gamma=2.0)),
    Variant("scatter, gamma 4", partial(_render, gamma=4.0)),
    Variant("scatter, other aperture of the same area", _other_shape),
    Variant("scatter, 8-bit input", _of_8_bits),
    *(Variant(f"layered, {n}", partial(_render, renderer="layered", layers=n), "layered", n) for n in LAYERS),
    Variant("layered, 16, 8-bit input", partial(_of_8_bits, renderer="layered", layers=16)),
    *(Variant(f"thinlens, {n}", partial(_thin_lens, samples=n), "thinlens", n, geometry=True) for n in SAMPLES),
)
