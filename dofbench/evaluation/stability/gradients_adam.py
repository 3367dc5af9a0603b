"""Steps of Adam along gradients of any size, NaN included, against their closed form."""

from __future__ import annotations

import math

import numpy as np

from dofbench.evaluation.stability.case import KERNELS, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import differing, off, values
from dofbench.evaluation.stability.oracle import ROUNDINGS

_RATE, _EPSILON = 0.01, 1e-15
_SIGNS = np.array([1.0, -1.0, 0.0, 1.0, -1.0])


def _stepped(
    setting: Setting, gradient: np.ndarray, steps: int, found_inf: float | None = None, finite: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters that start at 0, and `exp_avg`, after `steps` steps along one gradient."""
    moved, first, second = (setting.tensor(np.zeros_like(gradient)) for _ in range(3))
    slope = setting.tensor(gradient)
    watched = None if found_inf is None else setting.tensor(found_inf).reshape(())
    for step in range(1, steps + 1):
        setting.kernel("adam")(
            [moved], [slope], [first], [second],
            steps=[step], lrs=[_RATE], eps=_EPSILON, finite=finite, found_inf=watched,
        )  # fmt: skip
    return values(moved), values(first)


def _same_gradient(setting: Setting, size: float, steps: int) -> Found:
    """With bias correction the means of a constant gradient are the gradient and its square."""
    moved, _ = _stepped(setting, size * _SIGNS, steps)
    expected = -_RATE * steps * _SIGNS * size / (size + _EPSILON)
    return Found(off(moved, expected), (ROUNDINGS + 2 * steps) * setting.eps)


def _bad_number(setting: Setting, bad: float) -> Found:
    gradient = _SIGNS.copy()
    gradient[3] = bad
    moved, _ = _stepped(setting, gradient, 1)
    return Found(float(differing(np.isnan(moved), np.arange(5) == 3)), 0.0)


def _left_out(setting: Setting, bad: float) -> Found:
    gradient = _SIGNS.copy()
    gradient[3] = bad
    moved, _ = _stepped(setting, gradient, 2, finite=True)
    gradient[3] = 0.0
    expected, _ = _stepped(setting, gradient, 2)
    return Found(float(differing(moved, expected)), 0.0)


def _held(setting: Setting) -> Found:
    gradient = _SIGNS.copy()
    gradient[3] = math.nan
    moved, first = _stepped(setting, gradient, 2, found_inf=1.0)
    return Found(float(np.abs(np.stack([moved, first])).sum() != 0.0), 0.0)


def adam() -> tuple[Case, ...]:
    """The cases, for the group "gradients"."""
    subject = Subject("gradients", "adam", KERNELS)
    return (
        *subject.each("adam-{size:g}-{steps}", _same_gradient, size=(1e-30, 1e-8, 1.0, 1e15), steps=(1, 200)),
        subject.case("adam-nan", _bad_number, bad=math.nan),
        *subject.each("adam-left-out-{bad:g}", _left_out, bad=(math.nan, math.inf, -math.inf)),
        subject.case("adam-held", _held),
    )
