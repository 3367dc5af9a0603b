"""The sweep, its levels and the semiglobal paths: compiled backends against the definition, and known results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from backends import GPU, compiled, every
from hypothesis import given, settings
from hypothesis import strategies as st
from pretended_device import pretended
from stereo_cases import LIMITS, PENALTIES, REFUSED, case, depths, plane_beside, share_of_differing, shifted
from tolerances import FLAT_SCORE, FLOAT32_GRADIENT, FLOAT32_VALUE, STEREO_AT_A_BORDER

from dofbench.runtime.ops import load


def kernel(backend: str, function: str = "stereo") -> Callable[..., Any]:
    return load("stereo", backend, function=function)


def assert_swept(backend: str, given_case: tuple[torch.Tensor, ...], **options: int) -> None:
    """That the scores are the definition's, and where its best plane is ahead, that it is the best one too."""
    found = kernel(backend)(*given_case, **options)
    expected = kernel("reference")(*(one.double() for one in given_case), **options)
    assert share_of_differing(found, expected) < STEREO_AT_A_BORDER and found.abs().max() <= 1 + FLOAT32_VALUE
    if expected.shape[2] > 1:
        first, second = expected.topk(2, dim=2).values.unbind(2)
        ahead = first - second > 2 * FLOAT32_GRADIENT
        differ = (found.argmax(2) != expected.argmax(2)) & ahead
        assert float(differ.float().mean()) < STEREO_AT_A_BORDER


@settings(max_examples=12)
@given(st.integers(1, 24), st.integers(2, 40), st.integers(1, 4), st.integers(1, 7), st.integers(1, 3), st.data())
def test_the_cpu_s_sweep_is_the_definition(height, width, sources, planes, radius, data):
    best = data.draw(st.integers(1, sources))
    assert_swept("cpu", case(height, width, sources, planes, data.draw(st.integers(0, 99))), radius=radius, best=best)


# Windows larger than the image, fewer of the sources than there are, one pixel; two strips of rows; two blocks of
# columns.
@pytest.mark.parametrize(
    ("size", "sources", "planes", "radius", "best"),
    [
        ((9, 13), 2, 3, 1, 1),
        ((5, 4), 3, 2, 3, 3),
        ((11, 6), 4, 2, 2, 2),
        ((1, 1), 1, 1, 1, 1),
        ((35, 3), 1, 1, 1, 1),
        ((2, 131), 1, 2, 1, 1),
    ],
)
@pytest.mark.parametrize("backend", [GPU])
def test_the_sweep_is_the_definition(backend, size, sources: int, planes: int, radius: int, best: int) -> None:
    assert_swept(backend, case(*size, sources, planes, seed=1), radius=radius, best=best)


@compiled
def test_sources_of_another_size(backend: str) -> None:
    reference, _, maps, disparities = case(6, 7, 2, 2, seed=2)
    assert_swept(backend, (reference, torch.rand(2, 9, 5), maps, disparities), radius=1, best=2)
    assert_swept(backend, (reference, torch.rand(2, 1, 1), maps, disparities), radius=1, best=1)


@compiled
def test_pixels_behind_a_camera_and_in_its_plane(backend: str) -> None:
    """Coordinates that are infinite, not a number, or those of points behind the camera, in one source of three each:
    of all pixels, of one column, of all pixels."""
    reference, sources, maps, disparities = case(6, 8, 3, 2, seed=3)
    maps[0] = 0.0
    maps[1, 2] = torch.tensor([1.0, 0.0, -3.5, 0.0])
    maps[2] *= -1.0
    assert_swept(backend, (reference, sources, maps, disparities), radius=1, best=2)
    assert (kernel(backend)(reference, sources[::2], maps[::2], disparities, radius=1, best=2) == 0).all()


@compiled
def test_a_flat_image_matches_nothing(backend: str) -> None:
    flat, maps = torch.full((9, 9), 0.7), torch.eye(3, 4)[None]
    assert kernel(backend)(flat, flat[None], maps, torch.ones(2), radius=3, best=1).abs().max() < FLAT_SCORE


@every
def test_a_pixel_outside_all_sources_scores_as_unrelated_patches_do(backend: str) -> None:
    """A source that looks a hundred pixels past the image: half-way between agreement, 1, and its opposite, -1."""
    image, maps = torch.rand(5, 6), torch.eye(3, 4)[None].clone()
    maps[0, 0, 2] = 100.0
    assert (kernel(backend)(image, image[None], maps, torch.ones(2), radius=1, best=1) == 0).all()


@pytest.mark.parametrize("backend", [GPU])
def test_planes_swept_in_parts_have_the_same_bits(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = kernel(backend)(*case(4, 5, 2, 3, seed=0), radius=1, best=2)
    monkeypatch.setattr("dofbench.runtime.ops.stereo.gpu.SCRATCH", 1)
    assert torch.equal(kernel(backend)(*case(4, 5, 2, 3, seed=0), radius=1, best=2), whole)


def test_blocks_of_columns_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    scores, guide = torch.rand(9, 83, 11), torch.rand(9, 83)
    whole = kernel("cpu", "semiglobal")(scores, guide, **PENALTIES)
    monkeypatch.setattr("dofbench.runtime.ops.stereo.cpu.SCRATCH", 1)
    parts = kernel("cpu", "semiglobal")(scores, guide, **PENALTIES)
    assert all(torch.equal(*pair) for pair in zip(whole, parts, strict=True))


@every
def test_a_shifted_image_matches_at_its_shift(backend: str) -> None:
    image, sources, maps = shifted(8, 20)
    scores = kernel(backend)(image, sources, maps, torch.arange(2.0, 5.0), radius=2, best=1)
    plane, score, margin = kernel(backend, "semiglobal")(scores, image, **PENALTIES)
    inner = slice(2, -2), slice(4, -6)
    assert (scores[inner].argmax(-1) == 1).all() and (plane[inner] - 1).abs().max() < 0.2
    assert torch.equal(score[inner], scores[inner][..., 1]) and score[inner].min() > 0.99
    assert margin.isinf().all()  # three planes have none at a distance from the best


# The last has more planes than a warp holds.
@compiled
@pytest.mark.parametrize("size", [(6, 7, 9), (1, 1, 1), (3, 4, 2), (5, 1, 17), (1, 6, 3), (2, 2, 130)])
def test_paths_are_the_definition(backend: str, size: tuple[int, int, int]) -> None:
    scores, guide = torch.rand(size), torch.rand(size[:2])
    expected = kernel("reference", "semiglobal")(scores.double(), guide.double(), **PENALTIES)
    for one, other in zip(kernel(backend, "semiglobal")(scores, guide, **PENALTIES), expected, strict=True):
        assert torch.allclose(one.double(), other, atol=FLOAT32_GRADIENT)


@compiled
def test_the_first_of_equally_good_planes_is_chosen(backend: str) -> None:
    """Two planes that mirror each other, so that their costs are equal to the bit."""
    scores, guide = torch.zeros(3, 4, 9), torch.rand(3, 4)
    scores[..., 2] = scores[..., 6] = 1.0
    plane, score, margin = kernel(backend, "semiglobal")(scores, guide, **PENALTIES)
    assert (plane == 2).all() and (score == 1).all() and (margin == 0).all()


@compiled
@pytest.mark.parametrize(
    ("fine", "coarse"), [((7, 9, 6), (3, 4, 3)), ((4, 5, 1), (2, 2, 1)), ((2, 3, 5), (1, 1, 1)), ((3, 2, 2), (3, 2, 5))]
)
def test_levels_are_mixed_linearly(backend: str, fine: tuple[int, int, int], coarse: tuple[int, int, int]) -> None:
    scores, other = torch.rand(fine), torch.rand(coarse)
    expected = scores.double()
    kernel("reference", "upsample")(expected, other.double(), 0.3)
    turned = scores.permute(2, 0, 1).clone(memory_format=torch.contiguous_format).permute(1, 2, 0)
    for found in (scores, turned):
        kernel(backend, "upsample")(found, other, 0.3)
        assert torch.allclose(found.double(), expected, atol=FLOAT32_VALUE)


@compiled
def test_a_level_with_fewer_planes_keeps_linear_scores(backend: str) -> None:
    """Scores that grow with the plane do so at both ends and between, whatever the number of planes."""
    scores, coarse = torch.zeros(6, 8, 13), torch.linspace(0, 1, 5).expand(3, 4, 5).contiguous()
    kernel(backend, "upsample")(scores, coarse, 1.0)
    assert torch.allclose(scores, torch.linspace(0, 1, 13).expand(6, 8, 13), atol=FLOAT32_VALUE)


@compiled
@pytest.mark.parametrize(("height", "width"), [(11, 14), (1, 1), (2, 90)])
@pytest.mark.parametrize("seed", [4, 5])
def test_returns_are_the_definition(backend: str, height: int, width: int, seed: int) -> None:
    found = kernel(backend, "returns")(*depths(height, width, seed), **LIMITS)
    expected = kernel("reference", "returns")(*depths(height, width, seed), **LIMITS)
    assert found.dtype == torch.bool and torch.equal(found, expected)


@every
def test_a_depth_returns_from_a_view_that_has_it_and_from_no_other(backend: str) -> None:
    """A plane, seen by a camera beside; then by one that saw something else."""
    plane, there, back = plane_beside()
    check = kernel(backend, "returns")
    found = check(plane, plane, there, back, pixels=1.0, share=0.02)
    assert found[:, :7].all() and not found[:, 7:].any()  # moved by two pixels, out of the image
    for other in (1.1 * plane, 0 * plane):
        assert not check(plane, other, there, back, pixels=1.0, share=0.02).any()


@compiled
@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_wrong_shapes_are_refused(backend: str, change: Callable[..., Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kernel(backend)(*change(*case(9, 9, 2, 3, 0)), radius=2, best=1)


@pytest.mark.parametrize(("radius", "best"), [(0, 1), (2, 0), (2, 3)])
def test_windows_and_counts_that_make_no_sense_are_refused(radius: int, best: int) -> None:
    with pytest.raises(ValueError, match="radius"):
        load("stereo")(*case(9, 9, 2, 3, 0), radius=radius, best=best)


def test_another_type_is_refused() -> None:
    reference, sources, maps, disparities = case(3, 3, 1, 1, seed=0)
    with pytest.raises(ValueError, match="stereo sources: expected torch.float32 on cpu like reference"):
        load("stereo")(reference, sources.double(), maps, disparities, radius=1, best=1)


@pytest.mark.skipif(GPU.marks[0].args[0], reason="no package triton")
def test_the_host_waits_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def call(device: str, backend: str) -> list[torch.Tensor]:
        image, sources, maps, disparities = (one.to(device) for one in case(4, 5, 2, 3, seed=0))
        views = [one.to(device) for one in depths(4, 5, seed=0)]
        scores = load("stereo", backend)(image, sources, maps.float(), disparities, radius=1, best=2)
        load("stereo", backend, function="upsample")(scores, image[:2, :2, None].contiguous(), 0.3)
        chosen = load("stereo", backend, function="semiglobal")(scores, image, **PENALTIES)
        return [scores, *chosen, load("stereo", backend, function="returns")(*views, **LIMITS)]

    with pretended(monkeypatch) as waits:
        found = call("cuda", "auto")
        assert waits == []
        found = [one.cpu() for one in found]
    for one, other in zip(found, call("cpu", "reference"), strict=True):
        assert torch.allclose(one, other, atol=FLOAT32_GRADIENT)
