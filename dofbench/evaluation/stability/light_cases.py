"""Extreme light: black, white, one highlight, NaN and infinity, the display encoding near zero."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.images import to_8bit, to_16bit
from dofbench.evaluation.stability.case import KERNELS, NUMPY, SINGLE_ON_CPU, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import summed
from dofbench.evaluation.stability.deviation import differing, gradient_at, not_finite, off, off_each, refuses, values
from dofbench.evaluation.stability.light_mixing import mixing
from dofbench.evaluation.stability.oracle import POWER, ROUNDINGS, dense_scatter
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, picture, radii
from dofbench.optics.defocus import scatter_defocus
from dofbench.optics.tone import TOE, fast_decode, fast_encode

GAMMAS = (1.0, 2.2, 4.0)


def _blurred(setting: Setting, image: np.ndarray, gamma: float = 2.2) -> np.ndarray:
    return values(
        scatter_defocus(setting.tensor(image), setting.tensor(radii(0.5)), Blur(gamma), backend=setting.backend)
    )


def _black(setting: Setting) -> Found:
    return Found(float(np.count_nonzero(_blurred(setting, np.zeros((HEIGHT, WIDTH, 3))))), 0.0)


def _black_gradient(setting: Setting, gamma: float) -> Found:
    image = picture()
    image[5:12, 6:20] = 0
    light, radius = setting.tensor(image, gradient=True), setting.tensor(radii(0.5), gradient=True)
    blurred = scatter_defocus(light, radius, Blur(gamma), backend=setting.backend)
    blurred.sum().backward()
    largest = float(np.abs(gradient_at(light)).max())
    return Found(not_finite(light.grad, radius.grad), 0.0, f"largest {largest:.3g}")


def _white(setting: Setting) -> Found:
    white = np.ones((HEIGHT, WIDTH, 3))
    bound = (2 * ROUNDINGS + HEIGHT * WIDTH / 2) * setting.eps + 2 * POWER * (setting.backend == "cpu")
    return Found(off(_blurred(setting, white), white), bound)


def _highlight(setting: Setting, form: str = "auto", brightness: float = 1e6) -> Found:
    image, radius = picture(), radii(0.5, 25.0 if form == "linear" else 10.0)
    image[8, 13] = brightness
    found = setting.kernel("scatter")(setting.tensor(image), setting.tensor(radius), form=form)
    exact = dense_scatter(image, radius, kind=np.float64)
    # The rounding of the bright pixel's weight matters. The weight's logarithm, 2 alpha (R - l), is up to 2 alpha times
    # the sum of the radius and the distance at which the edge is truncated; float32 rounds it by half an eps.
    argument = 2 * 4.0 * (2 * float(np.abs(radius).max()) + 4)
    bound = (argument + ROUNDINGS + radius.size / 2) * setting.eps + np.exp(-12.0) / 4
    return Found(off_each(found, exact), bound, f"each pixel as a share of itself; brightest {float(exact.max()):.3g}")


def _scaled(setting: Setting, factor: float) -> Found:
    scatter, radius = setting.kernel("scatter"), setting.tensor(radii(0.5))
    image = picture()
    plain = values(scatter(setting.tensor(image), radius))
    light = values(scatter(setting.tensor(image * np.float32(factor)), radius)) / factor
    return Found(off(light, plain), summed(setting, radius.numel()))


def _not_a_number(setting: Setting, value: float) -> Found:
    image = picture()
    image[8, 13, 1] = value
    found = values(setting.kernel("scatter")(setting.tensor(image), setting.tensor(radii(0.5))))
    silent = float(np.isfinite(found[8, 13, 1]))
    others = float(np.count_nonzero(~np.isfinite(found[..., (0, 2)])))
    return Found(silent + others, 0.0, f"{np.count_nonzero(~np.isfinite(found))} of {found.size} not finite")


# ---- display encoding ----


def _tones() -> np.ndarray:
    toe = TOE * np.array([1e-20, 1e-3, 0.5, 1 - 1e-6, 1.0, 1 + 1e-6, 2.0])
    return np.concatenate([[0.0, 1.0, 1.5, 30.0, 1e4], toe, np.linspace(0, 1, 256)]).astype(np.float32)


_Tones = Callable[[Tensor, float], Tensor]  # light or tones by an exponent


def _pair(setting: Setting) -> tuple[_Tones, _Tones]:
    """(decode, encode) of the backend."""
    return partial(fast_decode, backend=setting.backend), partial(fast_encode, backend=setting.backend)


def _expected_decode(tones: np.ndarray, gamma: float) -> np.ndarray:
    exact = tones.astype(np.longdouble)
    toe = np.longdouble(TOE)
    return np.where(
        exact >= toe, np.maximum(exact, toe) ** np.longdouble(gamma), exact * toe ** np.longdouble(gamma - 1)
    )


def _power_bound(setting: Setting, exponent: float, largest: float = 1e4) -> float:
    # x^e = 2^(e log2 x): the rounding error of the product e log2 x becomes the relative error of the result.
    stated = POWER if setting.backend == "cpu" else 0.0
    return (4 + exponent * abs(np.log2(TOE)) + exponent * np.log2(largest)) * setting.eps + stated


def _decoded(setting: Setting, gamma: float) -> Found:
    tones = _tones()
    found = _pair(setting)[0](setting.tensor(tones), gamma)
    return Found(off_each(found, _expected_decode(tones, gamma)), _power_bound(setting, gamma))


def _round_trip(setting: Setting, gamma: float) -> Found:
    to_light, to_display = _pair(setting)
    tones = setting.tensor(_tones())
    back = to_display(to_light(tones, gamma), gamma)
    # A relative error of decoding becomes 1 / gamma of it in encoding.
    bound = _power_bound(setting, gamma) / gamma + _power_bound(setting, 1 / gamma, 1e4**gamma)
    return Found(off_each(back, tones), bound)


def _slope_at_zero(setting: Setting, gamma: float) -> Found:
    near = TOE**gamma * np.array([0.0, 1e-30, 0.5, 1 - 1e-5, 1 + 1e-5])
    light = setting.tensor(near, gradient=True)
    _pair(setting)[1](light, gamma).sum().backward()
    slope = gradient_at(light)
    steepest = TOE ** (1 - gamma)
    # Expected is the line's slope below the toe, and 1 / gamma of it above.
    expected = np.where(near < TOE**gamma, steepest, steepest / gamma)
    note = f"slope {float(slope.max()):.4g}, finite"
    return Found(off_each(slope, expected), _power_bound(setting, gamma) + 2e-5, note)


def _continuous_toe(setting: Setting, gamma: float) -> Found:
    step = 64 * setting.eps
    to_light, to_display = _pair(setting)
    ends = setting.tensor(TOE * np.array([1 - step, 1 + step]))
    light = to_light(ends, gamma)
    display = to_display(light, gamma)
    jumps = [abs(float(pair[1] - pair[0])) / float(pair[0]) for pair in (light.detach(), display.detach())]
    return Found(max(jumps), 2 * step * max(gamma, 1.0) + 2 * _power_bound(setting, gamma))


def _negative(setting: Setting) -> Found:
    below = setting.tensor(np.array([-1e-30, -TOE, -0.5]))
    to_light, to_display = _pair(setting)
    return Found(off_each(to_display(to_light(below, 2.2), 2.2), below), 8 * setting.eps)


def _half_lit(setting: Setting, gamma: float) -> Found:
    # Half of every disc is black and half white: with gamma 1 this gives grey 0.5, with other gammas 0.5^(1 / gamma).
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    checks = np.repeat(((x + y) % 2)[..., None], 3, axis=2).astype(np.float32)
    radius = setting.tensor(np.full((HEIGHT, WIDTH), 1e4, np.float32))
    found = scatter_defocus(setting.tensor(checks), radius, Blur(gamma), backend=setting.backend)
    bound = summed(setting) + POWER * (setting.backend == "cpu")
    return Found(off(found, np.full(checks.shape, 0.5 ** (1 / gamma))), bound)


# ---- levels ----


def _levels(setting: Setting) -> Found:
    ends = np.array([[-1.0, 0.0, 1.0, 2.0, -np.inf, np.inf, 1e30]], np.float32)
    wrong = differing(to_8bit(ends), np.array([[0, 0, 255, 255, 0, 255, 255]]))
    wrong += differing(to_16bit(ends), np.array([[0, 0, 65535, 65535, 0, 65535, 65535]]))
    steps = np.arange(256) / 255
    fine = np.arange(65536) / 65535
    wrong += differing(to_8bit(steps.astype(np.float32)), np.arange(256))
    wrong += differing(to_16bit(fine.astype(np.float32)), np.arange(65536))
    return Found(wrong, 0.0)


def _nan_level(setting: Setting, bits: int) -> Found:
    image = picture()
    image[3, 4, 1] = np.nan
    return refuses(FloatingPointError, lambda: (to_8bit if bits == 8 else to_16bit)(image), "NaN")


def _cases() -> tuple[Case, ...]:
    scatter, tone = (Subject("light", subject, KERNELS) for subject in ("scatter", "tone"))
    defocused, linear = Subject("light", "defocus", SINGLE_ON_CPU), Subject("light", "scatter", SINGLE_ON_CPU[-1:])
    images = Subject("light", "images", NUMPY)
    return (
        defocused.case("black", _black),
        *defocused.each("black-gradient-gamma-{gamma:g}", _black_gradient, gamma=GAMMAS),
        defocused.case("white", _white),
        scatter.case("highlight-1e6", _highlight),
        linear.case("highlight-1e6-linear", _highlight, form="linear"),
        *scatter.each("highlight-1e{brightness_label}", _highlight, brightness={"12": 1e12, "30": 1e30}),
        *scatter.each("{factor_label}", _scaled, factor={"dim-2^-100": 2.0**-100, "bright-2^100": 2.0**100}),
        *scatter.each("{value:g}-in-the-image", _not_a_number, value=(np.nan, np.inf)),
        *tone.each("decode-gamma-{gamma:g}", _decoded, gamma=GAMMAS),
        *tone.each("round-trip-gamma-{gamma:g}", _round_trip, gamma=GAMMAS),
        *tone.each("slope-at-0-gamma-{gamma:g}", _slope_at_zero, gamma=GAMMAS),
        *tone.each("toe-gamma-{gamma:g}", _continuous_toe, gamma=GAMMAS),
        tone.case("negative", _negative),
        *defocused.each("mean-gamma-{gamma:g}", _half_lit, gamma=GAMMAS),
        *mixing(),
        images.case("levels", _levels),
        *images.each("nan-{bits}-bit", _nan_level, bits=(8, 16)),
    )


CASES = _cases()
