"""The sweep, its levels and the semiglobal paths: numba against the definition, and both against what is known."""

from __future__ import annotations

import numba
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from stereo_cases import LIMITS, PENALTIES, REFUSED, case, depths, plane_beside, share_of_differing, shifted
from tolerances import FLAT_SCORE, FLOAT32_GRADIENT, FLOAT32_VALUE, STEREO_AT_A_BORDER

from dofbench.runtime.ops import load


@settings(max_examples=12)
@given(st.integers(1, 24), st.integers(2, 40), st.integers(1, 4), st.integers(1, 7), st.integers(1, 3), st.data())
def test_the_kernel_is_the_definition(height, width, sources, planes, radius, data):
    best = data.draw(st.integers(1, sources))
    given_case = case(height, width, sources, planes, data.draw(st.integers(0, 99)))
    found = load("stereo")(*given_case, radius=radius, best=best)
    expected = load("stereo", "reference")(*(one.double() for one in given_case), radius=radius, best=best)
    assert share_of_differing(found, expected) < STEREO_AT_A_BORDER
    assert found.abs().max() <= 1 + FLOAT32_VALUE


@settings(max_examples=12)
@given(st.integers(1, 12), st.integers(1, 20), st.integers(1, 9), st.integers(0, 99))
def test_paths_are_the_definition(height, width, planes, seed):
    random = torch.Generator().manual_seed(seed)
    scores, guide = torch.rand(height, width, planes, generator=random), torch.rand(height, width, generator=random)
    found = load("stereo", function="semiglobal")(scores, guide, **PENALTIES)
    expected = load("stereo", "reference", function="semiglobal")(scores.double(), guide.double(), **PENALTIES)
    for one, other in zip(found, expected, strict=True):
        assert torch.allclose(one.double(), other, atol=FLOAT32_GRADIENT)


@given(st.integers(2, 14), st.integers(2, 14), st.integers(1, 9), st.integers(1, 9))
def test_levels_are_mixed_linearly(height, width, planes, few):
    random = torch.Generator().manual_seed(height)
    scores = torch.rand(height, width, planes, generator=random)
    coarse = torch.rand(height // 2, width // 2, few, generator=random)
    expected = scores.double()
    load("stereo", "reference", function="upsample")(expected, coarse.double(), 0.3)
    load("stereo", function="upsample")(scores, coarse, 0.3)
    assert torch.allclose(scores.double(), expected, atol=FLOAT32_VALUE)


def test_a_level_with_fewer_planes_keeps_what_is_linear():
    """Scores that grow with the plane do so at both ends and between, whatever the number of planes."""
    scores, coarse = torch.zeros(6, 8, 13), torch.linspace(0, 1, 5).expand(3, 4, 5).contiguous()
    load("stereo", function="upsample")(scores, coarse, 1.0)
    assert torch.allclose(scores, torch.linspace(0, 1, 13).expand(6, 8, 13), atol=FLOAT32_VALUE)


def test_blocks_of_columns_change_no_bit(monkeypatch):
    from dofbench.runtime.ops.stereo import cpu

    random = torch.Generator().manual_seed(0)
    scores, guide = torch.rand(9, 83, 11, generator=random), torch.rand(9, 83, generator=random)
    whole = cpu.semiglobal(scores, guide, **PENALTIES)
    monkeypatch.setattr(cpu, "SCRATCH", 1)
    assert all(torch.equal(*pair) for pair in zip(whole, cpu.semiglobal(scores, guide, **PENALTIES), strict=True))


@settings(max_examples=12)
@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 99))
def test_returns_are_the_definition(height, width, seed):
    found = load("stereo", function="returns")(*depths(height, width, seed), **LIMITS)
    expected = load("stereo", "reference", function="returns")(*depths(height, width, seed), **LIMITS)
    assert found.dtype == torch.bool and torch.equal(found, expected)


def test_a_depth_returns_from_a_view_that_has_it_and_from_no_other():
    """A plane, seen by a camera beside; then by one that saw something else."""
    plane, there, back = plane_beside()
    for backend in ("cpu", "reference"):
        check = load("stereo", backend, function="returns")
        found = check(plane, plane, there, back, pixels=1.0, share=0.02)
        assert found[:, :7].all() and not found[:, 7:].any()  # moved by two pixels, out of the image
        assert not check(plane, 1.1 * plane, there, back, pixels=1.0, share=0.02).any()
        assert not check(plane, 0 * plane, there, back, pixels=1.0, share=0.02).any()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_shifted_image_matches_at_its_shift(backend):
    image, sources, maps = shifted(30, 60)
    scores = load("stereo", backend)(image, sources, maps, torch.arange(7.0), radius=3, best=1)
    inner = scores[8:-8, 8:-12]
    assert (inner.argmax(-1) == 3).all() and inner[..., 3].min() > 0.99
    plane, score, margin = load("stereo", backend, function="semiglobal")(scores, image, **PENALTIES)
    assert (plane[8:-8, 8:-12] - 3).abs().max() < 0.2
    assert score[8:-8, 8:-12].min() > 0.99 and margin[8:-8, 8:-12].min() > 0.1


def test_a_flat_image_matches_nothing():
    flat = torch.full((20, 20), 0.7)
    maps = torch.eye(3, 4)[None]
    assert load("stereo")(flat, flat[None], maps, torch.ones(2), radius=3, best=1).abs().max() < FLAT_SCORE


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_pixel_that_no_source_sees_scores_as_unrelated_patches_do(backend):
    """A source that looks a hundred pixels past the image: half-way between agreement, 1, and its opposite, -1."""
    image = torch.rand(12, 20, generator=torch.Generator().manual_seed(0))
    maps = torch.eye(3, 4)[None].clone()
    maps[0, 0, 2] = 100.0
    assert (load("stereo", backend)(image, image[None], maps, torch.ones(2), radius=1, best=1) == 0).all()


def test_threads_change_no_bit():
    given_case = case(50, 70, 3, 9, 0)
    guide, found, threads = given_case[0], set(), numba.get_num_threads()
    try:
        for count in {1, threads}:
            numba.set_num_threads(count)
            scores = load("stereo")(*given_case, radius=2, best=2)
            chosen = load("stereo", function="semiglobal")(scores, guide, **PENALTIES)
            found.add((scores.numpy().tobytes(), *(one.numpy().tobytes() for one in chosen)))
    finally:
        numba.set_num_threads(threads)
    assert len(found) == 1


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_what_cannot_be_swept_is_refused(backend, change, message):
    with pytest.raises(ValueError, match=message):
        load("stereo", backend)(*change(*case(9, 9, 2, 3, 0)), radius=2, best=1)


@pytest.mark.parametrize(("radius", "best"), [(0, 1), (2, 0), (2, 3)])
def test_windows_and_counts_that_make_no_sense_are_refused(radius, best):
    with pytest.raises(ValueError, match="radius"):
        load("stereo")(*case(9, 9, 2, 3, 0), radius=radius, best=best)
