"""The scatter: its definition's properties, and both CPU forms against it in value and gradient."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from tolerances import (
    FINITE_DIFFERENCE,
    FLOAT32_GRADIENT,
    FLOAT32_VALUE,
    HIGHLIGHT,
    QUOTIENT_OF_SUMS_OF_180,
    SCATTER_DARK,
    SCATTER_ENERGY,
)

from dofbench.core.lens import ApertureShape
from dofbench.runtime.ops import load

DISC = ApertureShape()
HEXAGON = ApertureShape(blades=6, rotation=0.3, curvature=0.2)
PENTAGON = ApertureShape(blades=5, rotation=-0.4)
DONUT = ApertureShape(obstruction=0.5)
STOPPED_PENTAGON = ApertureShape(blades=5, rotation=0.1, obstruction=0.3)
WAYS = [
    pytest.param(DISC, "direct", id="disc-direct"),
    pytest.param(DISC, "linear", id="disc-linear"),
    pytest.param(HEXAGON, "direct", id="hexagon"),
    pytest.param(PENTAGON, "direct", id="pentagon"),
    pytest.param(DONUT, "direct", id="donut"),
    pytest.param(STOPPED_PENTAGON, "direct", id="stopped-pentagon"),
]

reference = load("scatter", "reference")
cpu = load("scatter", "cpu")


def scene(seed: int, height: int, width: int, low: float, high: float, channels: int = 3):
    """Random (image, signed radius of random sign, gradient of the result), float32."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(low, high, (height, width)) * rng.choice([-1.0, 1.0], (height, width))
    arrays = rng.random((height, width, channels)), radius, rng.standard_normal((height, width, channels))
    return tuple(torch.from_numpy(a.astype(np.float32)) for a in arrays)


def with_gradients(scatter, image, radius, gradient, dtype, **options):
    """(blurred, gradient by image, gradient by radius), float64."""
    image, radius = (t.to(dtype).detach().clone().requires_grad_() for t in (image, radius))
    blurred = scatter(image, radius, **options)
    blurred.backward(gradient.to(dtype))
    return tuple(t.detach().double() for t in (blurred, image.grad, radius.grad))


def relative(found, expected) -> float:
    """Largest difference over largest magnitude."""
    return float((found - expected).abs().max() / expected.abs().max().clamp_min(1e-300))


def assert_agrees(image, radius, gradient, form, **options):
    expected = with_gradients(reference, image, radius, gradient, torch.float64, **options)
    found = with_gradients(cpu, image, radius, gradient, torch.float32, form=form, **options)
    assert relative(found[0], expected[0]) < FLOAT32_VALUE
    assert relative(found[1], expected[1]) < FLOAT32_GRADIENT
    # Where the definition's gradient with respect to R is a sum of terms of order 1 that cancel, only rounding noise
    # remains.
    scale = max(float(expected[2].abs().max()), SCATTER_DARK * float(gradient.abs().max()))
    assert float((found[2] - expected[2]).abs().max()) / scale < FLOAT32_GRADIENT


# ------------------------------------------------------------------------------------------------ the definition


@pytest.mark.slow
@pytest.mark.parametrize("shape", [DISC, HEXAGON, DONUT])
def test_gradient_of_the_definition(shape):
    image, radius, _ = scene(1, 4, 5, 0.1, 2.5, channels=2)
    arguments = image.double().requires_grad_(), radius.double().requires_grad_()
    torch.autograd.gradcheck(lambda c, s: reference(c, s, shape=shape), arguments, atol=FINITE_DIFFERENCE)


def weight_sum(scatter, radius: float, **options) -> float:
    """Sum of a source's weights, measured by an impulse, which keeps w(0) / sum w of itself."""
    size = 2 * math.ceil(radius + 7) + 1
    image = torch.zeros(size, size, 1)
    image[size // 2, size // 2] = 1.0
    kept = float(scatter(image, torch.full((size, size), radius), **options)[size // 2, size // 2, 0])
    return (0.5 + 0.5 * math.tanh(4.0 * radius)) / (radius**2 + 0.2) / kept


@pytest.mark.parametrize(
    ("radius", "expected"),
    [(0.0, 2.51), (0.25, 3.39), (0.5, 2.35), (1.0, 2.62), (2.0, 2.86), (5.0, 3.09), (10.0, 3.13)],
)
@pytest.mark.parametrize("form", ["reference", "direct", "linear"])
def test_energy_of_a_source(radius, expected, form):
    """The published kernel's sums: docs/published-methods.md, "Scatter"."""
    options = {} if form == "reference" else {"form": form}
    found = weight_sum(reference if form == "reference" else cpu, radius, **options)
    assert found == pytest.approx(expected, abs=SCATTER_ENERGY)


def test_a_polygon_points_where_its_shape_says():
    """A triangle with a corner to the right spreads farthest to the right, nowhere as far to the left."""
    image = torch.zeros(31, 31, 1, dtype=torch.float64)
    image[15, 15] = 1.0
    triangle = ApertureShape(blades=3)
    for scatter, source in ((reference, image), (cpu, image.float())):
        row = scatter(source, torch.full((31, 31), 10.0, dtype=source.dtype), shape=triangle)[15, :, 0]
        assert row[15 + 9] > 0.5 * row[15] and row[15 - 6] < 0.01 * row[15]


# ------------------------------------------------------------------------------------------- CPU against definition


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "form"), WAYS)
def test_radii_beyond_the_range_of_float32_exponents(shape, form):
    assert_agrees(*scene(3, 24, 40, 0.0, 28.0), form, shape=shape)


@pytest.mark.parametrize("alpha", [0.7, 2.0, 10.0])
@pytest.mark.parametrize("form", ["direct", "linear"])
def test_softness(alpha, form):
    assert_agrees(*scene(4, 20, 33, 0.0, 6.0), form, alpha=alpha)


@pytest.mark.parametrize(("shape", "form"), WAYS)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 23), (23, 1), (2, 65), (17, 16)])
def test_image_sizes(shape, form, height, width):
    assert_agrees(*scene(5, height, width, 0.0, 5.0), form, shape=shape)


@pytest.mark.parametrize("channels", [1, 2, 4, 7])
@pytest.mark.parametrize("form", ["direct", "linear"])
def test_channels(channels, form):
    assert_agrees(*scene(6, 15, 18, 0.0, 5.0, channels), form)


@pytest.mark.parametrize("form", ["direct", "linear"])
def test_neighbours_of_focus(form):
    """R = 0, R of one sign and the other beside it, and edges that fall on pixel centres (R = l)."""
    image, _, gradient = scene(7, 12, 32, 0.0, 1.0)
    values = torch.tensor([0.0, -0.0, 1e-6, -1e-6, 0.1, -0.3, 0.5, 1.0, -1.0, 2.0, 3.0, -math.sqrt(2.0), 5.0, 1e-30])
    radius = values[torch.arange(12 * 32) % len(values)].reshape(12, 32)
    assert_agrees(image, radius, gradient, form)


@pytest.mark.parametrize("form", ["direct", "linear"])
@pytest.mark.parametrize("radius", [0.0, 1e-4, 0.2])
def test_all_in_focus(form, radius):
    image, _, gradient = scene(8, 20, 20, 0.0, 1.0)
    assert_agrees(image, torch.full((20, 20), radius), gradient, form)


@pytest.mark.parametrize("scatter", [reference, cpu])
def test_gradient_at_focus_counts_as_nearer(scatter):
    """sgn(0) = +1: at s = 0 the gradient is the one for s slightly above it, and the opposite of that below."""
    image, _, gradient = scene(9, 8, 9, 0.0, 1.0)
    by_radius = [
        with_gradients(scatter, image, torch.full((8, 9), s), gradient, torch.float32)[2]
        for s in (0.0, -0.0, 1e-7, -1e-7)
    ]
    assert by_radius[0].abs().max() > 0
    for other, sign in zip(by_radius[1:], (1, 1, -1), strict=True):
        assert relative(sign * other, by_radius[0]) < FLOAT32_GRADIENT


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**31),
    height=st.integers(1, 14),
    width=st.integers(1, 40),
    largest=st.floats(0.01, 60.0),
    form=st.sampled_from(["auto", "direct", "linear"]),
    energy=st.sampled_from(["area", "algorithm1"]),
)
def test_any_small_scene(seed, height, width, largest, form, energy):
    assert_agrees(*scene(seed, height, width, 0.0, largest), form, energy=energy)


@example(seed=11966, blades=0, rotation=0.0, curvature=0.0, obstruction=0.2, largest=1.5)
@given(
    seed=st.integers(0, 2**31),
    blades=st.sampled_from([0, 3, 4, 6, 9]),
    rotation=st.floats(-4, 4),
    curvature=st.floats(0, 1),
    obstruction=st.sampled_from([0.0, 0.2, 0.8]),
    largest=st.floats(0.01, 20.0),
)
def test_any_aperture(seed, blades, rotation, curvature, obstruction, largest):
    shape = ApertureShape(blades, rotation, curvature, obstruction)
    assert_agrees(*scene(seed, 9, 20, 0.0, largest), "auto", shape=shape)


@pytest.mark.parametrize(("seed", "obstruction"), [(11966, 0.2), (3, 0.8)])
def test_a_central_stop_costs_no_digits(seed, obstruction):
    """Where the stop takes most of what a pixel keeps, the tails of others count for more, and must not be left out."""
    image, radius, _ = scene(seed, 9, 20, 0.0, 1.5)
    shape = ApertureShape(obstruction=obstruction)
    expected = reference(image.double(), radius.double(), shape=shape)
    assert relative(cpu(image, radius, shape=shape).double(), expected) < QUOTIENT_OF_SUMS_OF_180


# ------------------------------------------------------------------------------------------------ what must hold


@pytest.mark.parametrize(("shape", "form"), WAYS)
def test_a_constant_image_stays_constant(shape, form):
    _, radius, _ = scene(10, 25, 35, 0.0, 9.0)
    blurred = cpu(torch.full((25, 35, 3), 0.7), radius, shape=shape, form=form)
    assert relative(blurred, torch.full_like(blurred, 0.7)) < FLOAT32_VALUE


@pytest.mark.parametrize("shape", [DISC, DONUT, STOPPED_PENTAGON])
def test_inside_every_hole_there_is_still_a_colour(shape):
    """A central stop much larger than the image leaves little light, but no 0 / 0."""
    blurred = cpu(torch.full((3, 3, 3), 0.5), torch.full((3, 3), 200.0), shape=shape)
    assert relative(blurred, torch.full_like(blurred, 0.5)) < FLOAT32_VALUE


@pytest.mark.parametrize("form", ["direct", "linear"])
def test_a_shifted_scene_gives_the_shifted_image(form):
    image, radius, _ = scene(11, 40, 60, 0.0, 4.0)
    whole = cpu(image, radius, form=form)
    part = cpu(image[5:, 9:].contiguous(), radius[5:, 9:].contiguous(), form=form)
    margin = 8  # beyond the reach of what was cut away
    assert relative(part[margin:, margin:], whole[5 + margin :, 9 + margin :]) < FLOAT32_VALUE


@pytest.mark.parametrize("form", ["direct", "linear"])
def test_a_highlight_drowns_nothing(form):
    """HDR: 1e6 times brighter than its surroundings; right to 1e-4 of every pixel, not only of the brightest."""
    rng = np.random.default_rng(12)
    image = torch.from_numpy(rng.uniform(0.1, 1.0, (60, 90, 3)).astype(np.float32))
    radius = torch.from_numpy(rng.uniform(0.0, 9.0, (60, 90)).astype(np.float32))
    image[30, 40], radius[30, 40] = 1e6, 9.0
    expected = reference(image.double(), radius.double())
    blurred = cpu(image, radius, form=form).double()
    assert relative(blurred, expected) < FLOAT32_VALUE
    assert ((blurred - expected).abs() / expected).max() < HIGHLIGHT


def test_only_one_gradient_wanted():
    image, radius, gradient = scene(15, 10, 12, 0.0, 3.0)
    expected = with_gradients(cpu, image, radius, gradient, torch.float32)
    colours = image.clone().requires_grad_()
    cpu(colours, radius).backward(gradient)
    assert torch.equal(colours.grad.double(), expected[1])


# ------------------------------------------------------------------------------------------------ failures


@pytest.mark.parametrize("scatter", [reference, cpu])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_radius_that_is_not_finite_is_an_error(scatter, bad):
    image, radius, _ = scene(16, 5, 6, 0.0, 2.0)
    radius[2, 3] = bad
    with pytest.raises(FloatingPointError, match="signed_radius"):
        scatter(image, radius)


@pytest.mark.parametrize("form", ["direct", "linear"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_bad_colour_is_not_hidden(form, bad):
    image, radius, _ = scene(17, 9, 11, 0.0, 2.0)
    image[4, 5, 1] = bad
    assert not torch.isfinite(cpu(image, radius, form=form)[4, 5, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda i, s: (i.double(), s.double()), "found float64 on cpu, expected float32 on cpu"),
        (lambda i, s: (i, s.double()), "scatter signed_radius: expected torch.float32"),
        (lambda i, s: (i[..., 0], s), "image: expected shape"),
        (lambda i, s: (i[:0], s[:0]), "image: expected shape"),
        (lambda i, s: (i, s[:-1]), "signed_radius: expected shape"),
    ],
)
def test_tensors_that_do_not_fit(change, message):
    image, radius, _ = scene(18, 5, 6, 0.0, 2.0)
    with pytest.raises(ValueError, match=message):
        cpu(*change(image, radius))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alpha": 0.0}, "alpha"),
        ({"alpha": math.nan}, "alpha"),
        ({"energy": "none"}, "energy"),
        ({"form": "fast"}, "form"),
        ({"form": "linear", "shape": HEXAGON}, "form"),
        ({"form": "linear", "shape": DONUT}, "form"),
    ],
)
def test_options_that_do_not_exist(options, message):
    image, radius, _ = scene(19, 5, 6, 0.0, 2.0)
    with pytest.raises(ValueError, match=message):
        cpu(image, radius, **options)


@pytest.mark.parametrize("form", ["reference", "direct", "linear"])
@pytest.mark.parametrize("energy", ["area", "algorithm1"])
@pytest.mark.parametrize("radius", [1.0, 2.5, 6.0])
def test_a_pixel_s_light_is_spread_as_its_formula_says(form: str, energy: str, radius: float) -> None:
    """One blurred bright pixel among sharp dark ones, written out: each pixel's weight is its edge function (Eq. 6),
    which the public renderers divide by R^2 + 0.2."""
    size, middle = 15, 7
    image, radii = torch.zeros(size, size, 1), torch.zeros(size, size)
    image[middle, middle], radii[middle, middle] = 1.0, radius
    kernel = reference if form == "reference" else cpu
    more = {} if form == "reference" else {"form": form}
    given = (image.double(), radii.double()) if form == "reference" else (image, radii)
    found = kernel(*given, alpha=4.0, energy=energy, **more)

    def edge(reach: float, distance: float) -> float:
        return 0.5 + 0.5 * math.tanh(4.0 * (reach - distance))

    for row, column in ((middle, middle), (middle, middle + 1), (middle - 1, middle + 1), (middle, middle + 5)):
        light = total = 0.0
        for i in range(size):
            for j in range(size):
                reach = radius if (i, j) == (middle, middle) else 0.0
                weight = edge(reach, math.hypot(i - row, j - column))
                weight /= reach**2 + 0.2 if energy == "area" else 1.0
                light += weight * ((i, j) == (middle, middle))
                total += weight
        assert float(found[row, column, 0]) == pytest.approx(light / total, abs=FLOAT32_VALUE)
