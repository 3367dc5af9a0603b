"""The eight-lane vectors against numpy, and the kernel cache, which depends on the sources."""

import os
import subprocess
import sys

import numpy as np
import pytest
from numba import njit
from tolerances import EIGHT_LANES, EXP2_FAST

from dofbench.runtime.simd import any8, bits8, mask8_of, select8, sums8
from dofbench.runtime.simd_functions import abs8, exp2_fast8, exp8, floor8, floor_int, log2_8, max8, min8
from dofbench.runtime.simd_memory import gather8, gather_pairs8, load8, scatter8, store8
from dofbench.runtime.simd_rows import (
    gather8_at,
    load_fours8,
    load_rows8,
    load_rows8_at,
    load_threes8,
    scatter8_at,
    store_rows8,
    store_rows8_at,
)

F = np.float32


@njit(error_model="numpy")
def functions(x, out):
    for i in range(0, x.size, 8):
        v = load8(x, i)
        store8(out[0], i, exp2_fast8(v))
        store8(out[1], i, exp8(v))
        store8(out[2], i, log2_8(abs8(v)))
        store8(out[3], i, floor8(v))


def test_functions():
    x = np.linspace(-80, 80, 16000, dtype=np.float32)
    x = x[x != 0][:15992]
    out = np.empty((4, x.size), np.float32)
    functions(x, out)
    exact = x.astype(np.float64)
    assert np.abs(out[0] / np.exp2(exact) - 1).max() < EXP2_FAST
    assert np.abs(out[1] / np.exp(exact) - 1).max() < EIGHT_LANES
    assert np.abs(out[2] - np.log2(np.abs(exact))).max() < EIGHT_LANES * 8
    assert np.array_equal(out[3], np.floor(x))


@njit(error_model="numpy")
def combinations(x, y, out, bits):
    a, b = load8(x, 0), load8(y, 0)
    store8(out[0], 0, sums8(a, a + b, a - b, a * b, -a, a / b, F(2.0) * a, a + F(1.0)))
    store8(out[1], 0, select8((a < b) & ~(b > F(0.5)) | (a == b), a, F(9.0)))
    store8(out[2], 0, min8(a, b) + max8(a, F(0.0)))
    scatter8(out[3], 0, 2, gather8(y, 7, -1))
    a += b
    a *= F(2.0)
    a -= b
    store8(out[4], 0, select8(mask8_of(0b10100101), a, b))
    bits[0], bits[1], bits[2] = bits8(a > b), any8(a > F(1e9)), floor_int(F(-2.5))


def test_operators():
    generator = np.random.default_rng(0)
    x, y = generator.normal(size=(2, 8)).astype(np.float32)
    y[3] = x[3]
    out, bits = np.zeros((5, 16), np.float32), np.zeros(3, np.int64)
    combinations(x, y, out, bits)
    sums = [v.sum(dtype=np.float64) for v in (x, x + y, x - y, x * y, -x, x / y, 2 * x, x + 1)]
    assert np.allclose(out[0, :8], sums, rtol=0, atol=EIGHT_LANES * 80)
    assert np.array_equal(out[1, :8], np.where((x < y) & ~(y > 0.5) | (x == y), x, F(9)))
    assert np.allclose(out[2, :8], np.minimum(x, y) + np.maximum(x, 0), rtol=0, atol=EIGHT_LANES * 8)
    assert np.array_equal(out[3, ::2], y[::-1])
    moved = (x + y) * 2 - y
    chosen = np.array([bool(0b10100101 >> lane & 1) for lane in range(8)])
    assert np.allclose(out[4, :8], np.where(chosen, moved, y), rtol=0, atol=EIGHT_LANES * 80)
    assert list(bits) == [sum(1 << lane for lane in range(8) if moved[lane] > y[lane]), 0, -3]


@njit(error_model="numpy")
def exponentials(x, out):
    store8(out, 0, exp8(load8(x, 0)))


def test_exp_at_its_ends():
    out = np.empty(8, np.float32)
    exponentials(np.array([np.nan, np.inf, -np.inf, 89, -90, 0, 1, -1], np.float32), out)
    assert np.isnan(out[0])
    assert list(out[1:6]) == [np.inf, 0, np.inf, 0, 1]


@pytest.mark.slow
def test_cached_code_is_forgotten_when_a_module_beside_it_changes(tmp_path):
    constants = tmp_path / "constants.py"
    (tmp_path / "kernel.py").write_text(
        "from numba import njit\nfrom dofbench.runtime.kernel_cache import cached\nimport constants\n"
        "@cached\n@njit\ndef scaled(x):\n    return x * constants.FACTOR\n"
        "print(scaled(1.0), sum(scaled.stats.cache_hits.values()))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    printed = []
    for factor in (2.0, 2.0, 3.0):
        constants.write_text(f"FACTOR = {factor}\n")
        done = subprocess.run(
            [sys.executable, "kernel.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        printed.append(done.stdout.split())
    assert printed == [["2.0", "0"], ["2.0", "1"], ["3.0", "0"]]


@njit(error_model="numpy")
def pairs(x, at, out):
    one, next_one = gather_pairs8(x, at, 1, 2)
    store8(out[0], 0, one)
    store8(out[1], 0, next_one)


def test_pairs_are_neighbours_at_any_eight_places():
    x = np.arange(20, dtype=np.float32) ** 2
    at, out = np.array([9, 3, 16, 0, 0, 7, 5, 12, 1], np.int32), np.zeros((2, 8), np.float32)
    pairs(x, at, out)
    assert np.array_equal(out, [x[at[1:] + 2], x[at[1:] + 3]])


@njit(error_model="numpy")
def rows_turned(x, rows, out):
    columns = load_rows8(x, 1, 11)
    store8(out[0], 0, columns[0])
    store8(out[0], 8, columns[7])
    store_rows8(out[1], 2, 9, columns)
    columns = load_rows8_at(x, rows, 10, 2)
    store8(out[2], 0, columns[3])
    store_rows8_at(out[3], rows, 10, 1, columns)
    scatter8_at(out[4], rows, 3, 2, gather8_at(x, rows, 7, 5))
    a, b, c = load_threes8(x, 4)
    store8(out[5], 0, a)
    store8(out[5], 8, b)
    store8(out[5], 16, c)
    a, b, c, d = load_fours8(x, 3)
    store8(out[6], 0, a)
    store8(out[6], 8, b)
    store8(out[6], 16, c)
    store8(out[6], 24, d)


def test_rows_become_lanes_and_lanes_rows():
    x = np.random.default_rng(0).normal(size=100).astype(np.float32)
    rows = np.array([3, 0, 7, 1, 8, 2, 5, 4], np.int32)
    out = np.zeros((7, 100), np.float32)
    rows_turned(x, rows, out)
    apart = np.stack([x[1 + 11 * row : 9 + 11 * row] for row in range(8)])
    assert np.array_equal(out[0, :16], np.concatenate([apart[:, 0], apart[:, 7]]))
    assert np.array_equal(out[1, 2:74].reshape(8, 9)[:, :8], apart)
    assert not out[1, [0, 1, 10, 19, 74]].any()  # between the rows, and around them
    listed = np.stack([x[10 * row + 2 : 10 * row + 10] for row in rows])
    assert np.array_equal(out[2, :8], listed[:, 3])
    assert np.array_equal(out[3, :90].reshape(9, 10)[rows, 1:9], listed)
    assert np.array_equal(out[4, 3 * rows + 2], x[7 * rows + 5])
    assert np.array_equal(out[5, :24].reshape(3, 8), x[4:28].reshape(8, 3).T)
    assert np.array_equal(out[6, :32].reshape(4, 8), x[3:35].reshape(8, 4).T)
