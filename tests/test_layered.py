"""The layered renderer against a thin lens in front of two planes, integrated lens point by lens point."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE

from dofbench.core.blur import Blur
from dofbench.core.lens import PhysicalLens
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.layered import _continued, _nearest, layered_blur
from dofbench.runtime.ops import load

MARGIN, HEIGHT, WIDTH = 16, 96, 112


def scatter(image, radius):
    return load("scatter", "cpu")(image.contiguous(), radius.contiguous())


def texture(seed: int, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(H, W, 3) smooth waves in [0, 1] at any coordinates."""
    generator = np.random.default_rng(seed)
    waves = [
        sum(
            np.cos(generator.uniform(-0.4, 0.4) * y + generator.uniform(-0.4, 0.4) * x + generator.uniform(0, 6.3))
            for _ in range(4)
        )
        for _ in range(3)
    ]
    return (np.stack(waves, axis=-1) + 4) / 8


def covered(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Where the front plane is: a disc and a slanted bar, with an edge one pixel soft."""
    disc = 22 - np.hypot(y - 60, x - 50)
    bar = 5 - np.abs(x - 100 + 0.3 * y)
    return np.clip(np.maximum(disc, bar) + 0.5, 0, 1)[..., None]


def seen_through_pinhole(dy: float = 0.0, dx: float = 0.0, front: float = 0.0, back: float = 0.0) -> np.ndarray:
    """The scene from a point (dy, dx) of the unit lens, where planes shift by their signed radii."""
    y, x = np.mgrid[: HEIGHT + 2 * MARGIN, : WIDTH + 2 * MARGIN].astype(float)
    mask = covered(y - front * dy, x - front * dx)
    return mask * texture(1, y - front * dy, x - front * dx) + (1 - mask) * texture(2, y - back * dy, x - back * dx)


def thin_lens(front: float, back: float, points: int = 400) -> np.ndarray:
    """Mean over a sunflower of lens points, which covers the disc evenly."""
    index = np.arange(points) + 0.5
    rho, angle = np.sqrt(index / points), math.pi * (1 + 5**0.5) * index
    views = (
        seen_through_pinhole(r * math.sin(a), r * math.cos(a), front, back) for r, a in zip(rho, angle, strict=True)
    )
    return sum(views) / points


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    inside = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
    return -10 * math.log10(np.mean((image[inside] - truth[inside]) ** 2))


@pytest.mark.slow
# Focus behind, in front, and in between: least gain of occlusion in dB. Where neither side is sharp, the bleeding of
# the plain scatter is less visible. Measured: 4.6, 6.8 and 0.4 dB. Repeating the nearest colour behind an edge gained
# over 5.0 and 0.5 in the first and the last, as these textures are smooth; on the planes of reports/renderer it was 3
# dB worse beside depth edges.
@pytest.mark.parametrize(("front", "back", "gain"), [(6.0, 0.0, 4.0), (0.0, -6.0, 6.0), (3.0, -3.0, 0.2)])
def test_it_is_closer_to_a_thin_lens_than_the_plain_scatter(front, back, gain):
    sharp = torch.from_numpy(seen_through_pinhole().astype(np.float32))
    y, x = np.mgrid[: HEIGHT + 2 * MARGIN, : WIDTH + 2 * MARGIN].astype(float)
    radius = torch.from_numpy(np.where(covered(y, x)[..., 0] > 0.5, front, back).astype(np.float32))
    truth = thin_lens(front, back)
    plain, layered = scatter(sharp, radius).numpy(), layered_blur(sharp, radius, scatter).numpy()
    assert psnr(layered, truth) > psnr(plain, truth) + gain


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 20), st.floats(-6, 6), st.floats(-6, 6))
def test_a_constant_stays_constant(seed, layers, low, high):
    generator = np.random.default_rng(seed)
    radius = torch.from_numpy(generator.uniform(min(low, high), max(low, high), (20, 24)).astype(np.float32))
    blurred = layered_blur(torch.full((20, 24, 3), 0.7), radius, scatter, layers=layers)
    assert torch.allclose(blurred, torch.tensor(0.7), rtol=0, atol=FLOAT32_VALUE)


def test_one_layer_and_one_plane_are_the_plain_scatter():
    generator = torch.Generator().manual_seed(0)
    image = torch.rand((30, 40, 3), generator=generator)
    radius = 4 * torch.rand((30, 40), generator=generator) - 2
    assert torch.equal(layered_blur(image, radius, scatter, layers=1), scatter(image, radius))
    flat = torch.full((30, 40), 3.0)
    assert torch.equal(layered_blur(image, flat, scatter), scatter(image, flat))


def test_a_sharp_foreground_is_left_alone_by_the_light_behind_it():
    """A white wall far out of focus, and a black plate in focus: the plain scatter makes the plate grey."""
    image = torch.ones((48, 64, 3))
    radius = torch.full((48, 64), -8.0)
    image[12:36, 16:48], radius[12:36, 16:48] = 0.0, 0.0
    inside = np.s_[16:32, 20:44]
    assert layered_blur(image, radius, scatter)[inside].max() < FLOAT32_VALUE
    assert scatter(image, radius)[inside].max() > 10 * FLOAT32_VALUE


def test_depth_decides_what_is_in_front():
    """A near plate out of focus spreads over the wall in focus, and its own edge lets the wall through."""
    image = np.full((48, 64, 3), 1.0, np.float32)
    depth = np.full((48, 64), 4.0, np.float32)
    image[:, 32:], depth[:, 32:] = 0.0, 1.0
    lens = PhysicalLens(aperture=8.0, focus_disparity=0.25, width=64)
    _, linear = defocus_numpy(image, depth, lens, Blur(renderer="layered"))
    ramp = linear[24, :, 0]
    assert ramp[20] > 1 - FLOAT32_VALUE and ramp[44] < FLOAT32_VALUE
    assert 0.4 < ramp[31:33].mean() < 0.6
    one = defocus_numpy(image, depth, lens, Blur(renderer="layered", layers=1))[1]
    plain = defocus_numpy(image, depth, lens)[1]
    assert np.array_equal(one, plain) and not np.array_equal(linear, plain)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_radius_that_is_not_finite_is_refused(bad):
    radius = torch.zeros((12, 16))
    radius[3, 4] = bad
    with pytest.raises(FloatingPointError):
        layered_blur(torch.zeros((12, 16, 3)), radius, scatter)


def test_away_from_depth_edges_it_is_the_plain_scatter():
    generator = torch.Generator().manual_seed(1)
    image = torch.rand((60, 80, 3), generator=generator)
    slope = torch.linspace(-6, 6, 80).repeat(60, 1)
    assert torch.equal(layered_blur(image, slope, scatter), scatter(image, slope))
    radius = torch.full((60, 80), 2.0)
    radius[:, :20] = -2.0
    assert torch.equal(layered_blur(image, radius, scatter)[:, 30:], scatter(image, radius)[:, 30:])


def test_a_seam_between_flat_surfaces_stays_clean():
    """Grey plate in focus before a white wall out of focus, its outline one pixel soft: no dark rim, no bright one."""
    y, x = np.mgrid[:64, :80].astype(float)
    plate = np.clip(18.3 - np.hypot(y - 32, x - 40) + 0.5, 0, 1)
    image = torch.from_numpy((plate * 0.2 + (1 - plate) * 0.9).astype(np.float32)[..., None].repeat(3, axis=2))
    radius = torch.from_numpy(np.where(plate > 0.5, 0.0, -6.0).astype(np.float32))
    # A flat wall blurs into itself, and the plate is sharp: the photograph is the picture.
    error = (layered_blur(image, radius, scatter) - image).abs().max()
    assert error < 0.05 < (scatter(image, radius) - image).abs().max()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.02, 0.9))
def test_what_is_hidden_is_a_mean_of_what_is_seen_whichever_way_the_picture_lies(seed, share):
    """Seen pixels stay, filled ones lie within their colours, and a picture mirrored or on its side is filled likewise.
    Sides are powers of two, so that no size is odd."""
    generator = np.random.default_rng(seed)
    image, known = generator.random((16, 32, 3)).astype(np.float32), generator.random((16, 32)) < share
    known[3, 5] = True
    filled = _continued(image, known)
    assert np.array_equal(filled[known], image[known])
    slack = FLOAT32_VALUE
    assert (filled >= image[known].min(axis=0) - slack).all() and (filled <= image[known].max(axis=0) + slack).all()
    for turn in (lambda it: it[:, ::-1], lambda it: it[::-1], lambda it: it.swapaxes(0, 1)):
        turned = _continued(np.ascontiguousarray(turn(image)), np.ascontiguousarray(turn(known)))
        assert np.allclose(turned, turn(filled), atol=FLOAT32_VALUE)


def test_what_is_hidden_behind_one_pixel_is_the_mean_around_it():
    """Of a block of 2 x 2 three pixels are seen, and the block's mean is theirs; what the pyramid then says between the
    blocks is a mixture by 9, 3, 3 and 1 sixteenths of the four nearest blocks."""
    blocks = np.arange(16, dtype=np.float32).reshape(4, 4)
    image = np.kron(blocks, np.ones((2, 2), np.float32))[..., None].repeat(3, axis=2)
    known = np.ones((8, 8), bool)
    known[4, 4] = False  # the upper left pixel of block (2, 2), near blocks (1, 2), (2, 1) and (1, 1)
    expected = (9 * blocks[2, 2] + 3 * blocks[1, 2] + 3 * blocks[2, 1] + blocks[1, 1]) / 16
    assert np.allclose(_continued(image, known)[4, 4], expected, rtol=FLOAT32_VALUE)


def test_the_nearest_pixel_is_found_for_every_pixel():
    """Of a half plane the pixel on its rim in the same row; of two plates that one which is nearer; a chosen pixel's
    own is itself."""
    chosen = np.zeros((9, 20), bool)
    chosen[:, :6], chosen[4, 17] = True, True
    rows, columns = np.divmod(_nearest(chosen), 20)
    y, x = np.mgrid[:9, :20]
    assert np.array_equal(rows[chosen], y[chosen]) and np.array_equal(columns[chosen], x[chosen])
    beside = (x > 5) & (x < 11)  # nearer to the half plane than to the pixel, in every row
    assert (rows[beside] == y[beside]).all() and (columns[beside] == 5).all()
    around = np.hypot(y - 4, x - 17) < 3.5
    assert (rows[around] == 4).all() and (columns[around] == 17).all()
