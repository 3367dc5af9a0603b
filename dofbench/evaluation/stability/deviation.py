"""Deviations of results from what is expected, and other small measurements that cases share."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability.case import Found, Setting


def values(tensor: Tensor | np.ndarray) -> np.ndarray:
    """A tensor or array as float64 on the host."""
    array = tensor.detach().cpu().numpy() if isinstance(tensor, Tensor) else np.asarray(tensor)
    return array.astype(np.float64)


def gradient_at(leaf: Tensor) -> np.ndarray:
    """The gradient that a backward pass left at a tensor, as float64 on the host."""
    assert leaf.grad is not None
    return values(leaf.grad)


def off(found: Tensor | np.ndarray, expected: Tensor | np.ndarray, scale: float | None = None) -> float:
    """Largest deviation, as a share of `scale`, by default the largest magnitude expected; infinity for NaN."""
    a, b = values(found), values(expected)
    if a.shape != b.shape:
        return math.inf
    if not a.size:
        return 0.0
    if not np.isfinite(a).all():
        return math.inf
    largest = float(np.abs(b).max()) if scale is None else scale
    deviation = float(np.abs(a - b).max())
    return deviation / largest if largest > 0 else (0.0 if deviation == 0 else math.inf)


def off_each(found: Tensor | np.ndarray, expected: Tensor | np.ndarray) -> float:
    """Largest deviation of any number as a share of itself; infinite if 0 is expected and another number is found."""
    a, b = values(found), values(expected)
    if a.shape != b.shape or not np.isfinite(a).all():
        return math.inf
    deviation = np.abs(a - b)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(deviation == 0, 0.0, deviation / np.abs(b))
    return float(share.max()) if share.size else 0.0


def differing(found: Tensor | np.ndarray, expected: Tensor | np.ndarray) -> float:
    """How many numbers aren't exactly equal; infinity for another shape. NaN isn't equal to any number."""
    a, b = values(found), values(expected)
    return float(np.count_nonzero(~(a == b))) if a.shape == b.shape else math.inf


def not_finite(*arrays: Tensor | np.ndarray | None) -> float:
    """How many numbers are NaN or infinite."""
    return float(sum(np.count_nonzero(~np.isfinite(values(array))) for array in arrays if array is not None))


def refuses(kind: type[Exception], call: Callable[[], object], *words: str) -> Found:
    """The number of words that the text of the raised error lacks; 1 without an error of this kind."""
    try:
        call()
    except kind as error:
        message = " ".join(str(error).split())
        missing = [word for word in words if word not in message]
        return Found(float(len(missing)), 0.0, f"{kind.__name__}: {message}"[:160])
    return Found(1.0, 0.0, "went through without an error")


def in_folder(measure: Callable[..., Found]) -> Callable[..., Found]:
    """Give a measure an empty temporary folder in place of the setting."""

    @wraps(measure)
    def run(setting: Setting, **options: Any) -> Found:
        with tempfile.TemporaryDirectory(prefix="dofbench-stability-") as folder:
            return measure(Path(folder), **options)

    return run
