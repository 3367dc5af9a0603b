"""The thin lens blurs as the formula says, depth is that of the plane, and the stated noise is right."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import DOT_DEPTH, FLOAT32_VALUE, LENS_CENTRE_PX, LENS_RADIUS, NOISE_STATED

from dofbench.core.cameras import Camera
from dofbench.core.lens import PhysicalLens
from dofbench.scenes.procedural.shapes import quad
from dofbench.scenes.procedural.stage import Lamp, Prop, Sphere, Stage
from dofbench.scenes.procedural.tracer import Tracer, sets_of

WIDTH, HEIGHT, FOCAL = 56, 48, 60.0
# Looks along the world's y, as the recipes' cameras do.
FORWARD = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, FORWARD)
DOT_PX = 2.0
SKY = 1e-6  # mitsuba needs a light at which it can aim rays


def dot(x, z):
    """A shining ball, DOT_PX pixels in radius, at depth z and x to the right."""
    return Stage((Prop(Sphere((x, z, 0.0), DOT_PX * z / FOCAL), (1.0, 1.0, 1.0), "lamp", radiance=40.0),), (), SKY)


def wall(distance):
    """A chequered wall across the view, lit by a lamp and the sky."""
    rows, columns = np.mgrid[0:32, 0:32]
    texture = np.where((rows // 4 + columns // 4) % 2 == 0, 0.85, 0.25)[..., None].repeat(3, axis=2)
    shape = quad((-9.0, distance, -9.0), (18.0, 0, 0), (0, 0, 18.0), (9, 9))
    return Stage((Prop(shape, texture),), (Lamp((-1.0, 0.0, 2.0), (0.0, distance, 0.0), 1.0, 20.0),), 0.3)


def spread(image):
    """Centre of the light, image coordinates, and the radius of the disc that has its second moment."""
    weight = image.astype(np.float64).sum(axis=2)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    centre = np.array([(weight * v).sum() for v in (x, y)]) / weight.sum()
    moment = (weight * ((x - centre[0]) ** 2 + (y - centre[1]) ** 2)).sum() / weight.sum() / 2
    # A disc's moment along an axis is a quarter of its squared radius; the dot's own and the pixel's add to it.
    return centre, 2 * math.sqrt(max(moment - DOT_PX**2 / 4 - 1 / 12, 0.0))


@pytest.mark.parametrize(("depth", "focus"), [(1.4, 3.0), (1.9, 3.0), (12.0, 3.0), (4.0, 1.5)])
def test_circle_of_confusion_has_the_radius_of_the_formula(variant, depth, focus):
    lens = PhysicalLens(aperture=24.0, focus_disparity=1 / focus, width=WIDTH)
    expected = abs(float(lens.signed_radius(1 / depth, WIDTH)))
    image = Tracer(dot(0.05 * depth, depth)).photograph(CAMERA, 512, "dot", lens).linear
    centre, radius = spread(image)
    assert expected > 4
    assert radius == pytest.approx(expected, rel=LENS_RADIUS)
    assert centre == pytest.approx([WIDTH / 2 + 0.05 * FOCAL, HEIGHT / 2], abs=LENS_CENTRE_PX)


def test_focus_is_a_plane_and_not_a_sphere(variant):
    """A dot far off the axis at the focus's z is sharp; its distance from the lens is another."""
    depth = 2.0
    lens = PhysicalLens(aperture=40.0, focus_disparity=1 / depth, width=WIDTH)
    # Off by 22 pixels the ray is 6.5 % longer than z: focused by its length the blur would be 1.3 pixels.
    _, radius = spread(Tracer(dot(22 / FOCAL * depth, depth)).photograph(CAMERA, 512, "off", lens).linear)
    assert radius < 0.6


def test_light_and_blur_in_pixels(variant):
    """A lens spreads a dot's light and loses none."""
    tracer = Tracer(dot(0.0, 2.0))
    sharp = tracer.photograph(CAMERA, 512, "a").linear
    blurred = tracer.photograph(CAMERA, 512, "b", PhysicalLens(30.0, 1 / 4, WIDTH)).linear
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=2 * LENS_RADIUS)
    assert blurred.max() < 0.5 * sharp.max()
    lens = PhysicalLens(aperture=11.0, focus_disparity=1 / 3, width=WIDTH // 2)
    _, radius = spread(Tracer(dot(0.0, 1.4)).photograph(CAMERA, 512, "wide", lens).linear)
    assert radius == pytest.approx(22 * (1 / 1.4 - 1 / 3), rel=LENS_RADIUS)


def test_depth_is_the_planes_and_zero_at_infinity(variant):
    assert Tracer(wall(3.5)).depth(CAMERA) == pytest.approx(np.full((HEIGHT, WIDTH), 3.5), rel=FLOAT32_VALUE)
    z = Tracer(dot(0.0, 2.0)).depth(CAMERA)
    assert (z == 0).mean() > 0.9
    # Pixel centres are half a pixel from the middle: the ball's front, but for its curvature.
    assert z[HEIGHT // 2, WIDTH // 2] == pytest.approx(2 - DOT_PX * 2 / FOCAL, abs=DOT_DEPTH)


@pytest.mark.slow
def test_noise_is_what_is_stated(variant):
    tracer, lens = Tracer(wall(2.5)), PhysicalLens(30.0, 0.7, WIDTH)
    rough, fine = (tracer.photograph(CAMERA, samples, f"n{samples}", lens) for samples in (32, 2048))
    noise = float(np.sqrt(np.mean((rough.linear - fine.linear) ** 2)))
    assert rough.noise_rms == pytest.approx(noise, rel=NOISE_STATED)
    assert fine.noise_rms < 0.3 * rough.noise_rms
    assert fine.noise_psnr > rough.noise_psnr + 10
    assert (rough.samples, fine.samples) == (32, 2048)


def test_the_same_key_gives_the_same_image_and_another_another(variant):
    tracer, lens = Tracer(wall(2.5)), PhysicalLens(30.0, 0.7, WIDTH)
    one, again, other = (tracer.photograph(CAMERA, 32, key, lens).linear for key in ("a", "a", "b"))
    assert np.array_equal(one, again) and not np.array_equal(one, other)


def test_a_window_shows_what_the_whole_does(variant):
    tracer, lens = Tracer(wall(2.5)), PhysicalLens(6.0, 0.7, WIDTH)
    rows, columns = slice(10, 30), slice(7, 40)
    whole = tracer.photograph(CAMERA, 512, "w", lens)
    part = tracer.photograph(CAMERA, 512, "p", lens, window=(rows, columns))
    difference = float(np.sqrt(np.mean((whole.linear[rows, columns] - part.linear) ** 2)))
    assert difference < 2 * math.hypot(whole.noise_rms, part.noise_rms)
    moved = float(np.sqrt(np.mean((whole.linear[11:31, 7:40] - part.linear) ** 2)))
    assert moved > 3 * difference


def test_what_the_renderer_cannot_do_is_refused(variant):
    tracer = Tracer(dot(0.0, 2.0))
    with pytest.raises(ValueError, match="focus"):
        tracer.photograph(CAMERA, 8, "k", PhysicalLens(30.0, 0.0, WIDTH))
    with pytest.raises(ValueError, match="square"):
        tracer.photograph(CAMERA.resized(WIDTH, HEIGHT + 4), 8, "k")


@given(st.integers(2, 20000))
def test_sets_are_whole_and_halve(samples):
    count, size = sets_of(samples)
    assert count % 2 == 0 and math.isqrt(size) ** 2 == size <= 64
    assert samples <= count * size < samples + 2 * size
