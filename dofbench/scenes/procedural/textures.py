"""Procedural textures and skies, from one random generator.

Textures are encoded RGB, float32 (height, width, 3). Patterns are irregular, since structure from motion confuses
repeats; their detail has two to ten rendered pixels, where feature matching and the eye notice defocus.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dofbench.optics.tone import encode
from dofbench.scenes.procedural.ink import Colour, disc, frame, print_lines, rectangle, ring, stroke, text

INK: Colour = (0.10, 0.10, 0.13)
PAPER: Colour = (0.93, 0.91, 0.85)
BRIGHT: tuple[Colour, ...] = (
    (0.86, 0.28, 0.22),
    (0.95, 0.72, 0.22),
    (0.22, 0.52, 0.70),
    (0.30, 0.62, 0.38),
    (0.93, 0.90, 0.82),
    (0.55, 0.32, 0.58),
    (0.18, 0.24, 0.36),
    (0.92, 0.52, 0.30),
)
WORDS = ("FOCUS", "LENS", "BOKEH", "DEPTH", "IRIS", "FIELD", "LIGHT", "PRISM", "OPTIC", "SHARP", "BLUR", "PLANE")


def fractal(rng: np.random.Generator, height: int, width: int, slope: float = 1.6, stretch: float = 1.0) -> np.ndarray:
    """Periodic noise (height, width), zero mean, unit variance, amplitude falling as 1 / frequency ** slope.

    stretch > 1 draws the features out along the width.
    """
    fy = np.fft.fftfreq(height)[:, None] * height
    fx = np.fft.fftfreq(width)[None, :] * stretch * height
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal((height, width))) / frequency**slope
    noise = np.fft.ifft2(spectrum).real
    return noise / noise.std()


def mix(low: Colour, high: Colour, weight: np.ndarray) -> np.ndarray:
    """Blend two colours by a weight map (height, width); weights outside [0, 1] saturate."""
    weight = np.clip(weight, 0.0, 1.0)[..., None]
    return np.array(low) * (1 - weight) + np.array(high) * weight


def finish(image: np.ndarray) -> np.ndarray:
    """Keep reflectance physical: between 3 % and 90 % of linear light, as real paints are."""
    return np.clip(image, *encode(np.array([0.03, 0.90]))).astype(np.float32)


def flat(height: int, width: int, colour: Colour) -> np.ndarray:
    """A sheet of one colour."""
    return np.full((height, width, 3), colour)


def some(rng: np.random.Generator) -> Colour:
    """One of the bright colours."""
    return BRIGHT[int(rng.integers(len(BRIGHT)))]


def wood(rng: np.random.Generator, height: int = 1024, width: int = 1024, planks: int = 9) -> np.ndarray:
    """A table top of planks along the width, each with its own tone, grain and a few knots."""
    rows, columns = np.mgrid[0:height, 0:width] / height
    grain = fractal(rng, height, width, 1.2, stretch=9.0)
    fine = fractal(rng, height, width, 0.9, stretch=14.0)
    inner = (np.arange(1, planks) + rng.uniform(-0.2, 0.2, planks - 1)) / planks
    plank = np.searchsorted(inner, rows, side="right")
    tone, phase = rng.uniform(-0.22, 0.22, planks)[plank], rng.uniform(0, 9, planks)[plank]
    knots = np.zeros_like(rows)
    for _ in range(3 * planks):
        y, x = rng.uniform(0, 1), rng.uniform(0, width / height)
        knots += np.exp(-(((rows - y) / 0.010) ** 2 + ((columns - x) / 0.020) ** 2))
    rings = 0.5 + 0.5 * np.sin(60 * rows + 2.8 * grain + phase + 7 * knots)
    image = mix((0.40, 0.25, 0.15), (0.88, 0.68, 0.46), 0.45 + 0.40 * (rings - 0.5) + tone + 0.08 * fine - 0.7 * knots)
    image[np.min(np.abs(rows[:, :1] - inner), axis=1) < 0.0022] = (0.16, 0.10, 0.06)
    return finish(image)


def bricks(rng: np.random.Generator, height: int = 768, width: int = 1280, courses: int = 18) -> np.ndarray:
    """A painted brick wall in running bond; every brick has its own colour and wear."""
    tall = height / courses
    long = tall * 2.3
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    wobble, wear = fractal(rng, height, width, 1.8), fractal(rng, height, width, 1.3)
    course = np.floor(rows / tall).astype(int)
    shifted = columns + 0.5 * long * (course % 2)
    number = np.floor(shifted / long).astype(int)
    inside = np.minimum(np.minimum(rows % tall, tall - rows % tall), np.minimum(shifted % long, long - shifted % long))
    shape = (courses + 1, int(width / long) + 3)
    shade = 0.5 + rng.uniform(-0.45, 0.45, shape)[course, number] + 0.16 * wear
    grey = rng.choice([0.0, 0.0, 0.35, 0.75], shape)[course, number][..., None]
    image = (1 - grey) * mix((0.52, 0.31, 0.26), (0.82, 0.58, 0.46), shade)
    image += grey * mix((0.45, 0.47, 0.48), (0.85, 0.82, 0.76), shade)
    image[inside + 0.8 * wobble < 2.6] = (0.76, 0.74, 0.70)
    return finish(image + 0.03 * wear[..., None])


def plaid(rng: np.random.Generator, height: int = 768, width: int = 768) -> np.ndarray:
    """A woven cloth: irregular stripes both ways, thread texture, and scattered embroidered crosses."""

    def stripes(size: int) -> np.ndarray:
        line = np.zeros((size, 3))
        at = 0
        while at < size:
            step = int(rng.integers(size // 70, size // 12))
            line[at : at + step] = some(rng)
            at += step
        return line

    image = 0.5 * stripes(height)[:, None] + 0.5 * stripes(width)[None, :]
    rows, columns = np.mgrid[0:height, 0:width]
    thread = np.where((rows // 3 + columns // 3) % 2 == 0, 0.04, -0.04) + 0.02 * fractal(rng, height, width, 1.2)
    image += thread[..., None]
    for x, y in rng.uniform(0, 1, (110, 2)) * (width, height):
        size, colour = rng.uniform(5, 15), some(rng)
        stroke(image, (x - size, y - size), (x + size, y + size), 4, colour)
        stroke(image, (x - size, y + size), (x + size, y - size), 4, colour)
    return finish(image)


def newspaper(rng: np.random.Generator, height: int = 1024, width: int = 768) -> np.ndarray:
    """A printed page: masthead, columns of print, pictures."""
    image = mix(PAPER, (0.86, 0.83, 0.76), 0.5 + 0.3 * fractal(rng, height, width, 1.4))
    text(image, "THE DAILY FOCUS", (30, 30, width - 60, 76), INK)
    stroke(image, (30, 124), (width - 30, 124), 5, INK)
    column = (width - 60) // 3
    for x in range(30, width - 60, column):
        y = 140
        while y < height - 90:
            tall = min(int(rng.integers(110, 230)), height - 20 - y)
            if rng.random() < 0.25:
                picture = mix(INK, some(rng), 0.5 + 0.5 * fractal(rng, tall - 14, column - 16, 1.4))
                image[y : y + tall - 14, x : x + column - 16] = picture
            else:
                text(image, str(rng.choice(WORDS)), (x, y, column - 30, 36), INK)
                print_lines(rng, image, (x, y + 46, column - 18, tall - 40), 20, INK)
            y += tall
    return finish(image)


def cells(rng: np.random.Generator, height: int = 640, width: int = 896, count: int = 150) -> np.ndarray:
    """A stained-glass painting: Voronoi cells in bright colours, dark leading, brushed noise."""
    rows, columns = np.mgrid[0:height, 0:width]
    warp = 10 * fractal(rng, height, width, 1.8)
    seeds = cKDTree(rng.uniform(0, 1, (count, 2)) * (height, width))
    distance, owner = seeds.query(np.stack([rows + warp, columns - warp], axis=-1), k=2)
    palette = np.array(BRIGHT)[rng.integers(len(BRIGHT), size=count)] * rng.uniform(0.75, 1.1, (count, 1))
    image = palette[owner[..., 0]] + 0.04 * fractal(rng, height, width, 1.2)[..., None]
    image[distance[..., 1] - distance[..., 0] < 5] = INK
    return finish(image)


def relief(rng: np.random.Generator, height: int = 640, width: int = 896) -> np.ndarray:
    """A map: sea and land by height, contour lines, a graticule and place names."""
    ground = fractal(rng, height, width, 1.85)
    sea = mix((0.20, 0.42, 0.62), (0.60, 0.80, 0.86), 1 + 0.5 * ground)
    image = np.where((ground > 0)[..., None], mix((0.52, 0.70, 0.42), (0.90, 0.78, 0.54), 0.55 * ground), sea)
    to_line = np.abs((ground * 4 + 0.5) % 1 - 0.5) / (np.hypot(*np.gradient(ground * 4)) + 1e-6)
    image[to_line < 1.2] *= 0.62
    for x in range(width // 9, width, width // 8):
        stroke(image, (x, 0), (x, height), 1.5, INK)
    for y in range(height // 7, height, height // 5):
        stroke(image, (0, y), (width, y), 1.5, INK)
    for word, (x, y) in zip(rng.permutation(WORDS), rng.uniform(0, 1, (len(WORDS), 2)), strict=True):
        text(image, str(word), (x * width * 0.8, y * height * 0.9, width / 6, height / 18), INK)
    return finish(image)


def poster(rng: np.random.Generator, height: int = 896, width: int = 640) -> np.ndarray:
    """An eye chart: rows of letters that get smaller downwards."""
    image = flat(height, width, PAPER)
    y, tall, count = 36.0, 190.0, 2
    letters = list("DEFOPTZLCTBHKNRSVXAGMQWUY")
    while y + tall < height - 24:
        colour = (INK, BRIGHT[0], BRIGHT[2], BRIGHT[3])[count % 4]
        text(image, "".join(rng.choice(letters, count)), (44, y, width - 88, tall), colour)
        y, tall, count = y + 1.22 * tall, max(28.0, 0.74 * tall), count + 1
    frame(image, 6, 12, BRIGHT[0])
    return finish(image)


def quilt(rng: np.random.Generator, height: int = 512, width: int = 512, count: int = 6) -> np.ndarray:
    """Patchwork: squares that hold discs, crosses, stripes, dots or rings."""
    image = np.zeros((height, width, 3))
    dy, dx = height / count, width / count
    for row in range(count):
        for column in range(count):
            ground, figure = (BRIGHT[i] for i in rng.choice(len(BRIGHT), 2, replace=False))
            y, x = row * dy, column * dx
            rectangle(image, (x, y, dx + 1, dy + 1), ground)
            centre, radius, kind = (x + dx / 2, y + dy / 2), min(dx, dy) / 3, int(rng.integers(5))
            if kind == 0:
                disc(image, centre, radius, figure)
            elif kind == 1:
                stroke(image, (x + dx / 4, y + dy / 4), (x + 3 * dx / 4, y + 3 * dy / 4), dx / 5, figure)
                stroke(image, (x + 3 * dx / 4, y + dy / 4), (x + dx / 4, y + 3 * dy / 4), dx / 5, figure)
            elif kind == 2:
                for part in (0.1, 0.35, 0.6, 0.85):
                    rectangle(image, (x + part * dx, y, dx / 9, dy), figure)
            elif kind == 3:
                for dot in rng.uniform(0.15, 0.85, (7, 2)):
                    disc(image, (x + dot[0] * dx, y + dot[1] * dy), radius / 4, figure)
            else:
                ring(image, centre, radius, radius / 3, figure)
    return finish(image + 0.02 * fractal(rng, height, width, 1.2)[..., None])


def carton(rng: np.random.Generator, height: int = 768, width: int = 512) -> np.ndarray:
    """The front of a printed box: title, a round emblem, small print."""
    image = mix(BRIGHT[1], BRIGHT[7], 0.5 + 0.6 * fractal(rng, height, width, 2.0))
    text(image, "BOKEH", (24, 30, width - 48, 120), BRIGHT[6], 0.2)
    text(image, "FLAKES", (70, 168, width - 140, 66), BRIGHT[0], 0.2)
    centre, radius = (width / 2, 0.52 * height), 0.30 * width
    for index in range(6):
        disc(image, centre, radius * (1 - index / 6), BRIGHT[(3 * index + 2) % 8])
    for angle, r in zip(rng.uniform(0, 2 * np.pi, 60), radius * np.sqrt(rng.uniform(0, 1, 60)), strict=True):
        at = (centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle))
        disc(image, at, rng.uniform(5, 13), some(rng))
    rectangle(image, (24, 0.76 * height, width - 48, 0.24 * height - 24), PAPER)
    print_lines(rng, image, (36, int(0.775 * height), width - 72, int(0.2 * height)), 26, INK)
    return finish(image)


def label(rng: np.random.Generator, ground: Colour, height: int = 384, width: int = 1024) -> np.ndarray:
    """The wrap of a tin: coloured bands, words all the way round, dots."""
    image = flat(height, width, ground)
    rectangle(image, (0, height / 4, width, height / 2), PAPER)
    for index, word in enumerate(rng.choice(WORDS, 4, replace=False)):
        box = (index * width / 4 + 12, 0.34 * height, width / 4 - 24, 0.32 * height)
        text(image, str(word), box, (BRIGHT[0], BRIGHT[6], BRIGHT[3], BRIGHT[5])[index])
    for x in range(12, width, 25):
        for y in (height / 8, 7 * height / 8):
            disc(image, (x, y + rng.uniform(-14, 14)), rng.uniform(5, 13), some(rng))
    return finish(image + 0.015 * fractal(rng, height, width, 1.2)[..., None])


def spine(rng: np.random.Generator, ground: Colour, height: int = 640, width: int = 128) -> np.ndarray:
    """A book's spine: a title along it, bands, a publisher's mark, worn cloth."""
    ink = INK if sum(ground) > 1.5 else PAPER
    along = flat(width, height, ground)
    text(along, " ".join(rng.choice(WORDS, 2, replace=False)), (90, 0.2 * width, height - 210, 0.6 * width), ink)
    image = np.ascontiguousarray(np.rot90(along, 3))
    for y in (22, 50, height - 110, height - 40):
        rectangle(image, (0, y, width, rng.uniform(6, 18)), some(rng))
    ring(image, (width / 2, height - 66), width / 6, 6, ink)
    return finish(image + 0.03 * fractal(rng, height, width, 1.2)[..., None])


def marble(rng: np.random.Generator, height: int = 512, width: int = 1024) -> np.ndarray:
    """Veined stone."""
    veins = np.abs(np.sin(2.2 * fractal(rng, height, width, 1.9)))
    return finish(mix((0.16, 0.30, 0.28), (0.80, 0.86, 0.78), veins**0.6 + 0.05 * fractal(rng, height, width, 1.2)))


def letter(rng: np.random.Generator, glyph: str, colour: Colour, size: int = 256) -> np.ndarray:
    """One face of a toy block: a letter in a frame on pale wood."""
    grain = 0.5 + 0.3 * fractal(rng, size, size, 1.2, stretch=8)
    image = mix((0.80, 0.64, 0.44), (0.93, 0.82, 0.64), grain)
    frame(image, 10, 16, colour)
    text(image, glyph, (62, 50, size - 124, size - 100), colour, 0.22)
    return finish(image)


def leaf(rng: np.random.Generator, height: int = 512, width: int = 64) -> np.ndarray:
    """A grass blade: pale midrib, dark and light patches along it."""
    across = np.abs(np.linspace(-1, 1, width))[None, :]
    weight = 0.75 - 0.6 * across + 0.25 * fractal(rng, height, width, 1.1)
    return finish(mix((0.20, 0.42, 0.14), (0.74, 0.82, 0.38), weight))


def directions(height: int) -> np.ndarray:
    """(height, 2 height, 3) unit vectors of a sky map's pixels: first row the zenith, columns from x through y."""
    polar = (np.arange(height) + 0.5)[:, None] / height * np.pi
    around = (np.arange(2 * height) + 0.5)[None, :] / height * np.pi
    return np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) * np.ones_like(around)], axis=-1
    )


def cloudy(rng: np.random.Generator, sun: tuple[float, float, float], height: int = 512) -> np.ndarray:
    """Blue sky with clouds, brighter towards the horizon and the sun; (height, 2 height, 3) linear, float32. sun:
    direction; only its glow is in the map, as its disc is better rendered as a lamp."""
    way = directions(height)
    up = np.clip(way[..., 2], 0, 1)
    towards = np.clip(way @ (np.asarray(sun) / np.linalg.norm(sun)), 0, 1)
    blue = np.array([0.16, 0.34, 0.85]) * (0.55 + 0.25 * (1 - up[..., None]))
    haze = np.array([0.85, 0.88, 0.92]) * np.exp(-6 * up)[..., None]
    cover = fractal(rng, height, 2 * height, 1.7) + 0.35 * fractal(rng, height, 2 * height, 1.1)
    cloud = np.clip(0.9 * cover - 0.1, 0, 1)[..., None] * np.clip(3 * up, 0, 1)[..., None]
    sky = (blue * (1 - 0.6 * haze) + haze) * (1 - cloud) + cloud * np.array([1.0, 0.98, 0.96])
    sky = sky + (0.6 * towards**12 + 4.0 * towards**400)[..., None] * np.array([1.0, 0.85, 0.6])
    below = np.array([0.20, 0.22, 0.16])
    return np.where(way[..., 2:] > 0, sky, below).astype(np.float32)


def night(rng: np.random.Generator, height: int = 256) -> np.ndarray:
    """Deep blue, paler at the horizon; (height, 2 height, 3) linear, float32."""
    way = directions(height)
    up = np.clip(way[..., 2:], 0, 1)
    glow = np.exp(-5 * up) * np.array([0.060, 0.045, 0.055])
    cloud = np.clip(fractal(rng, height, 2 * height, 1.6), 0, 2)[..., None] * 0.004
    return (np.array([0.012, 0.016, 0.030]) + glow + cloud).astype(np.float32)
