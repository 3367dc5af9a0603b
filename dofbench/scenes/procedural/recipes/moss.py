"""Moss, toadstools and dew from a hand's breadth away: depth of field of a few millimetres. Units are metres."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from dofbench.scenes.procedural import textures
from dofbench.scenes.procedural.ink import Colour, disc
from dofbench.scenes.procedural.shapes import blade, ground, leaf, merged, quad, rod, turned
from dofbench.scenes.procedural.stage import Lamp, Mesh, Prop, Sphere, Stage, Viewpoints
from dofbench.scenes.procedural.textures import BRIGHT

TITLE = "moss, toadstools and dew from a hand's breadth away: macro"
VIEWPOINTS = Viewpoints((0.0, 0.0, 0.056), (0.0, 0.140, 0.012), (0.016, 0.003, 0.010), aim=0.003, focal=1.25, arc=60)


def stage(seed: int) -> Stage:
    """The whole scene; the same seed gives the same arrays."""
    rng = np.random.default_rng([seed, 26])
    lamps = (
        Lamp((0.20, 0.02, 0.32), (0.0, 0.16, 0.0), 0.10, 32.0),
        Lamp((-0.24, 0.28, 0.40), (0.0, 0.26, 0.0), 0.12, 30.0),
        Lamp((0.05, -0.02, 0.20), (0.0, 0.14, 0.0), 0.012, 240.0),
    )
    return Stage((*_floor(rng), *_moss(rng), *_toadstools(rng), *_snail(rng), *_dew(rng)), lamps, 0.30)


def _height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.004 * np.sin(60 * x + 1.0) * np.cos(46 * y) + 0.02 * np.clip(y - 0.16, 0, None)


def _floor(rng: np.random.Generator) -> Iterable[Prop]:
    soil = textures.mix((0.20, 0.15, 0.10), (0.52, 0.42, 0.28), 0.5 + 0.3 * textures.fractal(rng, 768, 768, 0.9))
    yield Prop(ground(np.linspace(-0.4, 0.4, 81), np.linspace(-0.1, 0.7, 81), _height, 0.12), textures.finish(soil))
    yield Prop(quad((-0.6, 0.62, -0.1), (1.2, 0, 0), (0, 0, 0.6)), textures.cells(rng, 640, 896, 130))
    # Fallen leaves of other colours lie between the moss and the wood behind.
    for _ in range(26):
        x, y = rng.uniform(-0.20, 0.20), rng.uniform(0.20, 0.50)
        angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.020, 0.045)
        lift = float(_height(np.array(x), np.array(y))) + rng.uniform(0.002, 0.008)
        along = size * np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.1, 0.3)])
        yield Prop(leaf((x, y, lift), along, (0.1, -0.1, 1.0), 0.6 * size, 0.2), _blotched(rng, textures.some(rng)))
    bark = np.ascontiguousarray(np.rot90(textures.wood(rng, 512, 768, 7)))
    log = [(0.035, 0.0), (0.034, 0.09), (0.032, 0.18), (0.0, 0.185)]
    yield Prop(turned(-0.12, 0.42, log, 0.0), bark)
    yield Prop(turned(0.15, 0.50, log, 0.0), bark)


def _blotched(rng: np.random.Generator, colour: Colour) -> np.ndarray:
    dark = (0.45 * colour[0], 0.40 * colour[1], 0.35 * colour[2])
    return textures.finish(textures.mix(dark, colour, 0.65 + 0.3 * textures.fractal(rng, 128, 128, 1.2)))


def _moss(rng: np.random.Generator) -> Iterable[Prop]:
    """Shoots with small leaves all round, thick in cushions, and grass between."""
    kinds: list[list[Mesh]] = [[], []]
    for cx, cy, count in (
        (-0.045, 0.105, 90),
        (0.050, 0.130, 90),
        (-0.01, 0.185, 110),
        (0.085, 0.22, 90),
        (-0.10, 0.24, 90),
    ):
        for _ in range(count):
            x, y = rng.normal(cx, 0.018), rng.normal(cy, 0.015)
            foot = np.array([x, y, float(_height(np.array(x), np.array(y)))])
            tall = rng.uniform(0.005, 0.013)
            for share in np.linspace(0.15, 1, 7):
                angle = rng.uniform(0, 2 * np.pi)
                along = 0.0038 * np.array([np.cos(angle), np.sin(angle), 0.7])
                kinds[int(rng.integers(2))].append(
                    leaf(foot + (0, 0, share * tall), along, (-along[0], -along[1], 0.004), 0.0011, 0.2, 2)
                )
    for shoots, (dark, light) in zip(
        kinds, (((0.16, 0.34, 0.10), (0.52, 0.70, 0.22)), ((0.30, 0.42, 0.12), (0.78, 0.80, 0.34))), strict=True
    ):
        weight = np.linspace(0, 1, 64)[:, None] + 0.15 * textures.fractal(rng, 64, 32, 1.0)
        yield Prop(merged(shoots), textures.finish(textures.mix(dark, light, weight)))
    blades = [
        blade(
            (x, y, 0.0),
            (rng.uniform(-0.02, 0.02), rng.uniform(-0.01, 0.01)),
            rng.uniform(0.03, 0.07),
            0.0022,
            rng.uniform(-0.5, 0.5),
        )
        for x, y in zip(rng.uniform(-0.09, 0.09, 14), rng.uniform(0.09, 0.30, 14), strict=True)
    ]
    yield Prop(merged(blades), textures.leaf(rng))


def _cap(rng: np.random.Generator, colour: Colour) -> np.ndarray:
    """A toadstool's skin with pale warts; v from rim to crown."""
    image = textures.mix(
        (0.8 * colour[0], 0.7 * colour[1], 0.7 * colour[2]), colour, 0.5 + 0.3 * textures.fractal(rng, 256, 512, 1.3)
    )
    for x, y in rng.uniform(0, 1, (70, 2)) * (512, 200):
        disc(image, (x, y), rng.uniform(3, 9), (0.93, 0.90, 0.82))
    return textures.finish(image)


def _toadstools(rng: np.random.Generator) -> Iterable[Prop]:
    for x, y, size, colour in (
        (0.012, 0.122, 0.80, BRIGHT[0]),
        (-0.028, 0.145, 1.15, (0.80, 0.46, 0.20)),
        (0.046, 0.172, 1.30, BRIGHT[0]),
        (-0.070, 0.205, 1.5, (0.72, 0.58, 0.36)),
        (0.020, 0.245, 1.6, (0.86, 0.66, 0.30)),
    ):
        stem = [(size * r, size * z) for r, z in ((0.0045, 0.0), (0.0034, 0.006), (0.0030, 0.022))]
        cap = [
            (size * r, size * z)
            for r, z in (
                (0.0030, 0.021),
                (0.0125, 0.0205),
                (0.0122, 0.0225),
                (0.0095, 0.0265),
                (0.0050, 0.0290),
                (0.0, 0.0297),
            )
        ]
        base = float(_height(np.array(x), np.array(y)))
        yield Prop(turned(x, y, stem, base, 24), (0.90, 0.86, 0.76))
        yield Prop(turned(x, y, cap, base, 36), _cap(rng, colour), "glossy", 0.18)


def _snail(rng: np.random.Generator) -> Iterable[Prop]:
    """A shell of whorls on a foot, with feelers."""
    image = textures.flat(128, 256, (0.86, 0.74, 0.50))
    for column in range(0, 256, 37):
        image[:, column : column + 11] = (0.42, 0.26, 0.14)
    skin = textures.finish(image + 0.03 * textures.fractal(rng, 128, 256, 1.2)[..., None])
    for turn, radius, lift in (
        (0.0, 0.0085, 0.0095),
        (2.0, 0.0068, 0.013),
        (4.1, 0.0050, 0.0155),
        (6.0, 0.0032, 0.0170),
    ):
        centre = (-0.012 + 0.003 * np.cos(turn), 0.094 + 0.002 * np.sin(turn), lift)
        yield Prop(
            Sphere((float(centre[0]), float(centre[1]), float(centre[2])), radius, 50 * turn), skin, "glossy", 0.10
        )
    spine = [np.array([-0.027 + 0.0052 * i, 0.093, 0.0028 + 0.0008 * max(i - 4, 0)]) for i in range(8)]
    body = [rod(one, two, 0.0028, 10) for one, two in itertools.pairwise(spine)]
    feelers = [rod((0.0085, 0.093, 0.006), (0.0130, 0.093 + lean, 0.0165), 0.0004, 6) for lean in (-0.003, 0.003)]
    yield Prop(merged([*body, *feelers]), (0.58, 0.48, 0.36))


def _dew(rng: np.random.Generator) -> Iterable[Prop]:
    """Drops as small glossy beads along stalks of sedge."""
    stalks = []
    for x, y, lean in ((-0.062, 0.088, 0.022), (0.034, 0.090, -0.012), (0.068, 0.150, -0.03)):
        places = [np.array([x + lean * t**2, y + 0.01 * t, 0.060 * t * (1 - 0.25 * t)]) for t in np.linspace(0, 1, 12)]
        stalks += [rod(a, b, 0.0006, 6) for a, b in itertools.pairwise(places)]
        for place in places[3:]:
            radius = float(rng.uniform(0.0009, 0.0017))
            centre = (float(place[0]), float(place[1]), float(place[2]) + radius)
            yield Prop(Sphere(centre, radius), (0.72, 0.82, 0.88), "glossy", 0.04)
    yield Prop(merged(stalks), (0.36, 0.48, 0.20))
