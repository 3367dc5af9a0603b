"""What aperture A and focus F mean: one lens model for datasets, methods and metrics.

Signed circle-of-confusion radius in pixels, for an image `width` pixels wide:
`s = K (d - F)` with `K = 0.02 * width * A` and `d` the normalised disparity
(DoF-Gaussian, Eq. 5, written in disparity; its r is used as a radius, as the public renderers do).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

from dofbench.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

COC_FRACTION = 0.02  # CoC radius at A = 1, per unit of normalised disparity, as a share of the width
GAMMA = 2.2  # the paper's colour-space note (supplement)
ALPHA = 4.0  # smoothness of the confusion function, paper section 5
AREA_EPSILON = 0.2  # of the area term 1 / (R^2 + 0.2) in the public renderers
LAYERS = 8  # default of the layered renderer; more layers are no more accurate (reports/renderer)


@dataclass(frozen=True)
class DisparityRange:
    """The disparities that are called 0 (far, q_min) and 1 (near, q_max), 1 / scene unit.

    Raises ValueError unless both are finite and q_min < q_max.
    """

    q_min: float
    q_max: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.q_min) and math.isfinite(self.q_max) and self.q_max > self.q_min):
            raise ValueError(f"disparity range: expected finite q_min < q_max, found {self.q_min}, {self.q_max}")

    @property
    def extent(self) -> float:
        """q_max - q_min, 1 / scene unit."""
        return self.q_max - self.q_min

    @staticmethod
    def of(depth: Any) -> DisparityRange:
        """The range of a depth map: percentiles 1 to 99 of the disparities where depth is known.

        depth: any shape, such as (H, W), scene units, an array or a tensor; zero, negative and non-finite values are
        unknown. Raises ValueError where none is known.
        """
        import numpy as np  # here and below: settings import this module, and help is to appear at once

        values = depth.detach().cpu().numpy() if hasattr(depth, "detach") else depth
        values = np.asarray(values, dtype=np.float64)
        return DisparityRange.of_disparity(1.0 / values[np.isfinite(values) & (values > 0)])

    @staticmethod
    def of_disparity(disparity: np.ndarray, low: float = 1.0, high: float = 99.0) -> DisparityRange:
        """From percentile `low` to percentile `high` of all finite positive values of `disparity`.

        disparity: any shape, such as (H, W), 1 / scene unit. Raises ValueError where none of it is positive.
        """
        import numpy as np

        known = disparity[np.isfinite(disparity) & (disparity > 0)]
        if known.size == 0:
            raise ValueError("disparity range: expected at least one positive disparity, found none")
        q_min, q_max = (float(q) for q in np.percentile(known, [low, high]))
        if q_max <= q_min:  # a fronto-parallel plane: any range does, as nothing but its place matters
            q_min, q_max = 0.5 * q_min, 1.5 * q_max
        return DisparityRange(q_min, q_max)

    def normalise(self, disparity: Any) -> Any:
        """Normalised disparity, 0 far ... 1 near, unclipped. Arrays, tensors and numbers alike."""
        return (disparity - self.q_min) / self.extent


class Framed(Protocol):
    """What a lens needs of the camera behind it: the image's width and the focal length along x, both in pixels.

    Where pixels aren't square, circles of confusion are counted along x, in pixels of the width.
    """

    @property
    def width(self) -> int:
        """Image width, pixels."""

    @property
    def fx(self) -> float:
        """Focal length along x, pixels."""


def framing(camera: Framed) -> float:
    """Focal length in image widths. The circles of confusion of one physical lens, as shares of the width, are in
    proportion to it: it changes where a camera is turned upright or an image is cropped, not where it is resized."""
    return camera.fx / camera.width


def framed_alike(cameras: Iterable[Framed]) -> bool:
    """Whether the cameras' framings agree to 2 %: structure from motion may give every photograph a focal length of its
    own, though one camera took all."""
    framings = [framing(camera) for camera in cameras]
    return not framings or max(framings) <= 1.02 * min(framings)


@dataclass(frozen=True)
class PhysicalLens:
    """A lens without any reference to a disparity range: R = aperture * |1/z - focus_disparity|.

    aperture: pixels * scene unit, for an image `width` pixels wide. focus_disparity: 1 / scene
    unit; zero is focus at infinity, negative beyond it. The aperture belongs to the camera that it was learned or
    planned with: aperture = fx * half the width of the lens's opening. `width` alone converts to another size of the
    same view; for another camera there is `transferred`.
    """

    aperture: float
    focus_disparity: float
    width: int

    @property
    def focus_depth(self) -> float:
        """Depth of the plane in focus, scene units; inf when nothing finite is in focus."""
        return 1.0 / self.focus_disparity if self.focus_disparity > 0 else math.inf

    def signed_radius(self, disparity: Any, width: int) -> Any:
        """Signed CoC radius in pixels of an image `width` wide, from disparity (1 / scene unit)."""
        return (self.aperture * (width / self.width)) * (disparity - self.focus_disparity)

    def aperture_at(self, width: int) -> float:
        """The aperture for an image of the same view that is `width` pixels wide, pixels * scene unit."""
        return self.aperture * width / self.width

    def half_opening(self, camera: Framed) -> float:
        """Half the width of the lens's opening, scene units. camera: the one this lens belongs to, at any size."""
        return self.aperture * (camera.width / self.width) / camera.fx

    def transferred(self, of: Framed, to: Framed) -> PhysicalLens:
        """The same opening and focus on another camera: the aperture grows with the focal length in pixels.

        of: the camera this lens belongs to, at any size. to: the other camera, whose width the result has.
        """
        return PhysicalLens(self.aperture_at(to.width) * (framing(to) / framing(of)), self.focus_disparity, to.width)


@dataclass(frozen=True)
class Lens:
    """A view's lens in normalised units: aperture A (0 ... 1) and focus F (0 far ... 1 near)."""

    aperture: float
    focus: float

    if not TYPE_CHECKING:  # where types aren't checked, the error says what to do

        def __getattr__(self, name: str) -> Any:
            if name in (*vars(PhysicalLens), *PhysicalLens.__dataclass_fields__):
                expected = "a PhysicalLens, such as lens.physical(disparity_range, width)"
                raise AttributeError(f"lens: found a Lens, which has no {name}, expected {expected}")
            raise AttributeError(f"'Lens' object has no attribute {name!r}")

    def radius_per_disparity(self, width: int) -> float:
        """K: CoC radius in pixels per unit of normalised disparity."""
        return COC_FRACTION * width * self.aperture

    def physical(self, disparity_range: DisparityRange, width: int) -> PhysicalLens:
        """The same lens in scene units."""
        return PhysicalLens(
            aperture=self.radius_per_disparity(width) / disparity_range.extent,
            focus_disparity=disparity_range.q_min + self.focus * disparity_range.extent,
            width=width,
        )

    @staticmethod
    def from_physical(lens: PhysicalLens, disparity_range: DisparityRange) -> Lens:
        """Express a physical lens in the units of `disparity_range`; the inverse of `physical`."""
        return Lens(
            aperture=lens.aperture * disparity_range.extent / (COC_FRACTION * lens.width),
            focus=float(disparity_range.normalise(lens.focus_disparity)),
        )


def in_scene_units(lens: PhysicalLens | Lens, disparity_range: DisparityRange | None, width: int) -> PhysicalLens:
    """The lens in scene units, of an image `width` pixels wide; a `PhysicalLens` as it is.

    disparity_range: what a `Lens` refers to. Raises InputError for a `Lens` without one.
    """
    if isinstance(lens, PhysicalLens):
        return lens
    if disparity_range is None:
        expected = "the disparity range that it refers to, such as DisparityRange.of(depth); or a PhysicalLens"
        raise InputError("lens", "a Lens without a disparity range", expected)
    return lens.physical(disparity_range, width)


@dataclass(frozen=True)
class ApertureShape:
    """A disc, or a regular polygon whose edges may bulge; it scales the CoC radius by direction.

    blades: 0 for a disc, else at least 3. rotation: radians, direction of the first corner,
    from +x (right) towards +y (down). curvature: 0 straight edges ... 1 a disc.
    obstruction: radius of a central stop as a share of the aperture's radius, 0 ... <1.
    Raises InputError for a shape that doesn't exist.
    """

    blades: int = 0
    rotation: float = 0.0
    curvature: float = 0.0
    obstruction: float = 0.0

    def __post_init__(self) -> None:
        if self.blades != 0 and self.blades < 3:
            raise InputError("shape blades", str(self.blades), "0 (a disc) or at least 3")
        if not math.isfinite(self.rotation):
            raise InputError("shape rotation", str(self.rotation), "a finite angle")
        if not 0 <= self.curvature <= 1:
            raise InputError("shape curvature", str(self.curvature), "0 to 1")
        if not 0 <= self.obstruction < 1:
            raise InputError("shape obstruction", str(self.obstruction), "0 to below 1")

    @property
    def is_disc(self) -> bool:
        """A full disc: the radius is the same in every direction and nothing is obstructed."""
        return (self.blades == 0 or self.curvature == 1) and self.obstruction == 0

    def radius_factor(self, angle: Any) -> np.ndarray:
        """Radius in a direction as a share of a corner's: (N,), as many as there are angles, in [0, 1].

        angle: (N,), or any other shape, radians from +x towards +y.

        A polygon's edge is at cos(pi/n) / cos(angle to the edge's middle); curvature mixes in 1.
        """
        import numpy as np

        if self.blades == 0:
            return np.ones_like(angle, dtype=np.float64)
        sector = 2 * math.pi / self.blades
        offset = np.mod(np.asarray(angle, dtype=np.float64) - self.rotation, sector) - sector / 2
        straight = math.cos(math.pi / self.blades) / np.cos(offset)
        return (1 - self.curvature) * straight + self.curvature


Energy = Literal["area", "algorithm1"]
# Renderers that need an image and its depth; and one that needs the scene's geometry as well.
Renderer = Literal["scatter", "layered"]
SceneRenderer = Literal["scatter", "layered", "thinlens"]
# What images of known lenses were blurred by; "light-field": nothing, they are averages of real views.
Defocus = Literal["scatter", "layered", "thinlens", "light-field"]
