"""Random rooms to train on, made of make-scene's shapes and textures.

A room has a floor, perhaps walls, and things of every size at every distance. Positions are random, so a network can't
learn to expect a thing at a certain place; only things lower in the picture tend to be nearer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.scenes.procedural import shapes, textures
from dofbench.scenes.procedural.stage import Finish, Lamp, Prop, Sphere, Stage, Tube, world_to_camera

NEAREST, FARTHEST = 0.7, 14.0  # distance of things from the camera, scene units; spread evenly in its logarithm


def texture_bank(rng: np.random.Generator, rounds: int) -> list[np.ndarray]:
    """Some textures of every kind, of sizes that give about one texel per rendered pixel."""
    bank = []
    for _ in range(rounds):
        bank += [
            textures.wood(rng, 384, 512, int(rng.integers(3, 12))),
            textures.bricks(rng, 384, 640, int(rng.integers(6, 22))),
            textures.plaid(rng, 320, 320),
            textures.newspaper(rng, 512, 384),
            textures.cells(rng, 320, 448, int(rng.integers(15, 160))),
            textures.relief(rng, 320, 448),
            textures.poster(rng, 448, 320),
            textures.quilt(rng, 320, 320, int(rng.integers(2, 8))),
            textures.carton(rng, 384, 256),
            textures.marble(rng, 256, 512),
            textures.leaf(rng),
            textures.label(rng, textures.some(rng), 192, 512),
        ]
        for slope in (0.6, 1.2, 2.0, 2.8):
            low, high = textures.some(rng), tuple(rng.uniform(0.1, 0.95, 3))
            noise = textures.fractal(rng, 256, 256, slope, float(rng.uniform(0.3, 3)))
            bank.append(textures.finish(textures.mix(low, high, 0.5 + rng.uniform(0.1, 0.5) * noise)))
    return bank


def room(rng: np.random.Generator, bank: list[np.ndarray]) -> Stage:
    """A room that is seen along +y from about the origin; the floor is z = 0."""
    things = [*_shell(rng, bank)]
    for _ in range(int(rng.integers(6, 36))):
        things.extend(_thing(rng, bank))
    lamps = tuple(
        Lamp(
            (float(rng.uniform(-4, 4)), float(rng.uniform(-2, 6)), float(rng.uniform(2.5, 7))),
            (float(rng.uniform(-1, 1)), float(rng.uniform(2, 6)), 0.3),
            side := float(rng.uniform(0.2, 2.5)),
            float(rng.uniform(20, 70)) / side**2,
        )
        for _ in range(int(rng.integers(0, 3)))
    )
    sky = float(rng.uniform(0.15, 0.5) if lamps else rng.uniform(0.6, 1.2))
    return Stage(tuple(things), lamps, sky)


def cameras(rng: np.random.Generator, count: int, width: int, height: int) -> list[Camera]:
    """Cameras of any field of view, well apart, that look approximately along +y. A room has several, because compiling
    it takes longer than rendering a view."""
    found = []
    for _ in range(count):
        eye = np.array([rng.normal(0, 0.6), rng.uniform(-1.2, 1.5), rng.uniform(0.25, 2.2)])
        focal = width * float(np.exp(rng.uniform(np.log(0.65), np.log(1.6))))
        yaw, roll = rng.normal(0, 0.35), rng.normal(0, 0.04)
        pitch = rng.uniform(-0.10, 0.55) * min(1.0, eye[2])  # downwards
        forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), -np.sin(pitch)])
        pose = world_to_camera(eye, forward, roll)
        found.append(Camera(width, height, focal, focal, width / 2, height / 2, pose))
    return found


def _shell(rng: np.random.Generator, bank: list[np.ndarray]) -> Iterator[Prop]:
    """Floor, back wall, side walls, each of which may be missing; the floor rarely is."""
    if rng.random() < 0.93:
        yield Prop(shapes.quad((-20, -4, 0), (40, 0, 0), (0, 34, 0), _repeat(rng, 12)), _paint(rng, bank, 0.2))
    wall = float(np.exp(rng.uniform(np.log(3.0), np.log(25.0))))
    slant = float(rng.normal(0, 0.25))
    if rng.random() < 0.85:
        height = float(rng.uniform(2, 9))
        sheet = shapes.quad((-20, wall - 20 * slant, -1), (40, 40 * slant, 0), (0, 0, height + 1), _repeat(rng, 6))
        yield Prop(sheet, _paint(rng, bank, 0.2))
    for side in (-1, 1):
        if rng.random() < 0.35:
            x = side * float(rng.uniform(1.2, 5))
            sheet = shapes.quad((x, -4, 0), (0, wall + 8, 0), (0, 0, float(rng.uniform(1, 6))), _repeat(rng, 6))
            yield Prop(sheet, _paint(rng, bank, 0.2))


def _repeat(rng: np.random.Generator, most: int) -> tuple[int, int]:
    count = int(rng.integers(1, most + 1))
    return count, count


def _paint(rng: np.random.Generator, bank: list[np.ndarray], plain: float) -> np.ndarray | tuple[float, float, float]:
    """A texture, or with probability `plain` a single colour, as walls often have."""
    colour = rng.uniform(0.1, 0.9, 3)
    if rng.random() < plain:
        return float(colour[0]), float(colour[1]), float(colour[2])
    return bank[int(rng.integers(len(bank)))]


def _thing(rng: np.random.Generator, bank: list[np.ndarray]) -> Iterator[Prop]:
    """One thing at a random distance: it stands on the floor, or floats."""
    y = float(np.exp(rng.uniform(np.log(NEAREST), np.log(FARTHEST))))
    x = float(rng.uniform(-0.75, 0.75)) * y
    size = float(np.exp(rng.uniform(np.log(0.06), np.log(0.55)))) * (0.5 + 0.5 * y)
    base = 0.0 if rng.random() < 0.7 else float(rng.uniform(0, 0.5 * y + 0.8))
    paint = _paint(rng, bank, 0.25)
    finish: Finish = "glossy" if rng.random() < 0.12 else "matt"
    turn = float(rng.uniform(0, 180))
    kind = rng.choice(["box", "ball", "post", "sheet", "grass", "rods"], p=[0.32, 0.2, 0.16, 0.16, 0.08, 0.08])
    if kind == "box":
        w, d, h = size * rng.uniform(0.4, 1.6, 3)
        yield Prop(shapes.box(x, y, (w, d, h), turn, base), paint, finish)
    elif kind == "ball":
        yield Prop(Sphere((x, y, base + 0.5 * size), 0.5 * size, turn), paint, finish)
    elif kind == "post":
        height, radius = size * float(rng.uniform(0.8, 4)), size * float(rng.uniform(0.05, 0.4))
        yield Prop(Tube((x, y, base), (x, y, base + height), radius, turn), paint, finish)
        yield Prop(shapes.lid(x, y, base + height, radius), paint)
    elif kind == "sheet":
        right, up = rng.normal(0, 1, 3), rng.normal(0, 1, 3)
        right, up = size * right / np.linalg.norm(right), size * up / np.linalg.norm(up)
        yield Prop(shapes.quad((x, y, base + 0.5 * size), right, up), paint)
    elif kind == "grass":
        for angle in rng.uniform(0, 2 * np.pi, int(rng.integers(4, 12))):
            lean = (float(0.4 * size * np.cos(angle)), float(0.4 * size * np.sin(angle)))
            root = (x + 0.1 * size * np.cos(angle), y + 0.1 * size * np.sin(angle), base)
            yield Prop(shapes.blade(root, lean, 1.5 * size, 0.05 * size, float(rng.uniform(-1, 1))), paint)
    else:
        for offset in np.linspace(-0.5, 0.5, int(rng.integers(3, 7))):
            at = (x + float(offset) * size, y, base)
            yield Prop(Tube(at, (at[0], at[1], base + size), 0.02 * size), paint)
