"""Planes in front of an exact thin lens: ground truth with little noise and exact depth, without a download.

Let p be the image of a point through the centre of a lens of unit radius, and s its signed radius. Through the aperture
sample u, the point is seen at p + s u. For a plane s is affine in p, so one division finds the point that a pixel sees.
A photograph is the mean over aperture samples. Occlusion is correct, since every plane has a complete texture.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import product

import numpy as np

from dofbench.core.blur import Blur
from dofbench.core.lens import ApertureShape
from dofbench.evaluation.renderer.lens_points import lens_points
from dofbench.evaluation.renderer.planes_lens import ALL, BARS, DISCS, LOWER_HALF, add_views
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.optics.tone import decode, encode

WIDTH, HEIGHT = 400, 300
OWN_ERROR_DB = 50.0  # least PSNR between half of the aperture samples and all: well above the renderers'
POINTS = (256, 1 << 13)  # aperture samples at first, and at most
_TEXTURE = 1024  # pixels, side of a plane's texture; it repeats
_STENCILS = {"all": ALL, "lower half": LOWER_HALF, "discs": DISCS, "bars": BARS}
_HEXAGON = ApertureShape(6)


@dataclass(frozen=True)
class Plane:
    """A textured plane, cut out by a stencil.

    texture: a seed; the finest detail is `detail` pixels. disparity: at the image's centre, 0 farthest, 1 nearest;
    slope: its change by x and y per half width. highlights: share of the texture that is `brightness` times white.
    """

    texture: int
    detail: float
    stencil: str
    disparity: float
    slope: tuple[float, float] = (0.0, 0.0)
    highlights: float = 0.0
    brightness: float = 30.0

    def __post_init__(self) -> None:
        if self.stencil not in _STENCILS:
            raise ValueError(f"stencil: expected one of {', '.join(_STENCILS)}, found {self.stencil!r}")


Scene = tuple[Plane, ...]  # far to near

SCENES: dict[str, Scene] = {
    "two walls": (Plane(1, 2.0, "all", 0.1), Plane(2, 2.0, "discs", 0.9)),
    "thin bars": (Plane(3, 2.0, "all", 0.05), Plane(4, 4.0, "bars", 0.85)),
    "slanted floor": (
        *(Plane(5, 3.0, "all", 0.0), Plane(6, 2.0, "lower half", 0.45, (0.0, 0.5))),
        Plane(7, 2.0, "discs", 1.0),
    ),
    "highlights": (Plane(8, 3.0, "all", 0.0, highlights=0.002), Plane(9, 3.0, "discs", 0.6)),
    "flat walls": (Plane(10, 60.0, "all", 0.1), Plane(11, 60.0, "discs", 0.8), Plane(12, 60.0, "bars", 1.0)),
}
_BY_HEXAGON = ("two walls", "highlights")


def plane_cases(radii: Iterable[float], focuses: Iterable[float]) -> Iterator[Case]:
    """Every scene through round lenses, some by a hexagon. radii: CoC radii, pixels per unit of disparity."""
    radii, focuses = tuple(radii), tuple(focuses)
    for name, radius, focus in product(SCENES, radii, focuses):
        yield _case("planes", name, SCENES[name], radius, focus, ApertureShape())
    for name, focus, radius in product(_BY_HEXAGON, focuses, radii[-1:]):
        yield _case("planes, hexagonal aperture", name, SCENES[name], radius, focus, _HEXAGON)


def _case(source: str, name: str, scene: Scene, radius: float, focus: float, shape: ApertureShape) -> Case:
    content = [[asdict(plane) for plane in scene], asdict(shape), WIDTH, HEIGHT, OWN_ERROR_DB, POINTS]
    make = partial(photograph, scene, radius, focus, shape)
    return Case(source, name, radius, focus, content, WIDTH * HEIGHT / 1e6, make, geometry=True)


def photograph(
    scene: Scene,
    radius: float,
    focus: float,
    shape: ApertureShape = ApertureShape(),
    own_error_db: float = OWN_ERROR_DB,
) -> Truth:
    """One scene through a lens of `radius` pixels per unit of disparity, focused at `focus`.

    Aperture samples are added until half of them have a PSNR of `own_error_db` against all, up to the largest number.
    """
    pinhole, signed_radius = seen(scene, radius, focus, np.zeros((1, 2)))
    halves = np.zeros((2, HEIGHT, WIDTH, 3))
    points, wanted = 0, POINTS[0]
    while True:
        halves += seen(scene, radius, focus, lens_points(wanted - points, shape, first=points))[0]
        points = wanted
        whole, half = _encoded(halves.sum(axis=0) / points), _encoded(halves[0] / (points / 2))
        difference = float(np.mean((whole - half) ** 2))
        reached = -10 * math.log10(difference) if difference > 0 else math.inf
        if reached >= own_error_db or points >= POINTS[1]:
            break
        wanted = 2 * points

    def thin_lens(samples: int) -> np.ndarray:
        # Other samples than the photograph's, or the renderer would be compared with itself.
        others = lens_points(samples, shape, first=4 * POINTS[1])
        return _encoded(seen(scene, radius, focus, others)[0].sum(axis=0) / samples)

    return Truth(
        sharp=encode(pinhole.sum(axis=0)).astype(np.float32),
        signed_radius=signed_radius.astype(np.float32),
        photograph=whole,
        border=math.ceil(radius) + 2,
        own_error_db=reached,
        blur=Blur(shape=shape),
        thin_lens=thin_lens,
    )


def seen(scene: Scene, radius: float, focus: float, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2, H, W, 3) linear light, summed over even and odd aperture samples, and the signed radius, (H, W), of the last.

    points: (N, 2), x and y.
    """
    light, front = np.zeros((2, 3, HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH))
    slopes = np.array([plane.slope for plane in scene]) * radius / (WIDTH / 2)
    offsets = radius * (np.array([plane.disparity for plane in scene]) - focus) - slopes @ (WIDTH / 2, HEIGHT / 2)
    stencils = np.array([_STENCILS[plane.stencil] for plane in scene])
    radii = np.column_stack([offsets, slopes])
    add_views(_pictures(scene), _TEXTURE, stencils, radii, np.ascontiguousarray(points), light, front)
    return light.transpose(0, 2, 3, 1), front


def _encoded(linear: np.ndarray) -> np.ndarray:
    return encode(np.clip(linear, 0, 1)).astype(np.float32)


@cache
def _pictures(scene: Scene) -> np.ndarray:
    """Each plane's texture, repeated to the right by a row of a view: (P, 3, 1024, 1024 + W + 1) float32."""
    pictures = np.stack([_picture(plane).transpose(2, 0, 1) for plane in scene])
    return np.ascontiguousarray(np.concatenate([pictures, pictures[..., : WIDTH + 1]], axis=3))


@cache
def _picture(plane: Plane) -> np.ndarray:
    """Periodic noise down to the plane's detail, and highlights: (1024, 1024, 3) float32, linear light."""
    generator = np.random.default_rng(plane.texture)
    fy, fx = np.meshgrid(np.fft.fftfreq(_TEXTURE), np.fft.fftfreq(_TEXTURE), indexing="ij")
    frequency = np.hypot(fy, fx)
    # Equal contrast in every octave up to the finest detail.
    spectrum = np.where(frequency > 0, 1 / np.maximum(frequency, 1 / _TEXTURE), 0)
    spectrum = spectrum * np.exp(-((frequency * 2 * plane.detail) ** 2))
    noise = generator.normal(size=(_TEXTURE, _TEXTURE, 3))
    waves = np.fft.ifft2(np.fft.fft2(noise, axes=(0, 1)) * spectrum[..., None], axes=(0, 1)).real
    picture = decode(np.clip(0.45 + 0.2 * waves / waves.std(), 0.0, 1.0))
    if plane.highlights > 0:
        lit = generator.random((_TEXTURE, _TEXTURE)) < plane.highlights / 4
        lit = lit | np.roll(lit, 1, 0) | np.roll(lit, 1, 1) | np.roll(lit, (1, 1), (0, 1))
        picture[lit] = plane.brightness
    return picture.astype(np.float32)
