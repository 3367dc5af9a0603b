"""Pixels that show two surfaces: the known share is recovered, and both parts together give the pixel."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, MIXED_COLOUR, MIXED_SHARE

from dofbench.optics.depth_edges import JUMP
from dofbench.optics.mixed_pixels import mixed_pixels


def step(cover: np.ndarray, near: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A picture of two colours by the cover of the nearer one, and its signed radius."""
    return cover[..., None] * near + (1 - cover[..., None]) * far, np.where(cover > 0.5, 4.0, -3.0)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.15, 0.85), st.lists(st.floats(0, 1), min_size=6, max_size=6))
def test_flat_colours_are_told_apart(share, colours):
    near, far = np.array(colours[:3]), np.array(colours[3:])
    cover = np.tile(np.where(np.arange(16) < 8, 1.0, 0.0), (12, 1))
    cover[:, 8] = share
    found = mixed_pixels(*step(cover, near, far))
    if ((near - far) ** 2).sum() > 0.01:
        assert np.array_equal(found.columns, np.full(12, 8)) and np.allclose(found.share, share, atol=MIXED_SHARE)
        assert np.allclose(found.near, near, atol=MIXED_COLOUR) and np.allclose(found.far, far, atol=MIXED_COLOUR)
    assert np.allclose(found.near_radius, 4) and np.allclose(found.far_radius, -3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.1, 50))
def test_both_parts_together_are_the_pixel(seed, brightness):
    generator = np.random.default_rng(seed)
    cover = np.clip(9 - np.hypot(*(np.mgrid[:24, :30] - 12.0)) + 0.5, 0, 1)
    image, radius = step(cover, 0.5, 0.3)
    image = image + 0.1 * generator.random(image.shape)
    image[generator.random(cover.shape) < 0.05] = brightness
    found = mixed_pixels(image, radius)
    share = found.share[:, None]
    together = share * found.near + (1 - share) * found.far
    pixel = image[found.rows, found.columns]
    # Except for a colour that would have to be negative.
    positive = (found.near > 0).all(axis=1) & (found.far > 0).all(axis=1)
    assert len(share) > 10 and positive.mean() > 0.5
    assert np.abs(together - pixel)[positive].max() < FLOAT32_VALUE * max(1.0, pixel.max())
    assert (found.near >= 0).all() and (found.far >= 0).all() and (found.share >= 0).all() and (found.share <= 1).all()


def test_a_highlight_beside_an_outline_is_not_put_into_it():
    cover = np.tile(np.where(np.arange(20) < 10, 1.0, 0.0), (16, 1))
    image, radius = step(cover, np.full(3, 0.4), np.full(3, 0.2))
    image[:, 10] = 0.3  # half of each
    image[8, 12] = 30.0
    found = mixed_pixels(image, radius)
    assert len(found.rows) > 10 and found.far.max() < 1


def test_without_a_jump_there_are_none():
    radius = np.tile(np.linspace(-6, 6, 40), (20, 1))
    assert mixed_pixels(np.zeros((20, 40, 3)), radius).rows.size == 0


def test_a_wire_is_left_as_it_is():
    radius = np.zeros((20, 20))
    radius[:, 10] = 5.0
    assert mixed_pixels(np.zeros((20, 20, 3)), radius).rows.size == 0


def test_nearer_pixels_say_more_by_the_square_of_their_distance():
    """A straight outline before column 8: of the far surface the columns 9 and 10 are seen, of which those in five rows
    weigh 1 / (1 + dy^2) and 1 / (4 + dy^2), together 2.4 and 0.9."""
    cover = np.tile(np.where(np.arange(16) < 8, 1.0, 0.0), (12, 1))
    cover[:, 8] = 0.5
    image, radius = step(cover, np.full(3, 0.8), np.full(3, 0.2))
    radius[:, 10] = -3.6
    found = mixed_pixels(image, radius)
    inside = (found.columns == 8) & (found.rows > 1) & (found.rows < 10)
    assert inside.sum() == 8
    expected = (2.4 * -3.0 + 0.9 * -3.6) / 3.3
    assert np.allclose(found.far_radius[inside], expected, rtol=FLOAT32_VALUE)
    assert np.allclose(found.near_radius[inside], 4.0, rtol=FLOAT32_VALUE)


def test_a_surface_exactly_a_jump_nearer_is_the_same_surface():
    """Both sides of an outline, and a third surface that is nearer than the far one by the bound itself: it counts as
    the far one's, so the near part of a mixed pixel hasn't its colour."""
    cover = np.tile(np.where(np.arange(16) < 8, 1.0, 0.0), (12, 1))
    cover[:, 8] = 0.5
    image, radius = step(cover, np.full(3, 0.2), np.full(3, 0.6))
    radius[:, 8] = -3.0
    image[:, 10:], radius[:, 10:] = 0.9, -3.0 + JUMP
    found = mixed_pixels(image, radius)
    assert len(found.rows) and np.allclose(found.near_radius, 4)
