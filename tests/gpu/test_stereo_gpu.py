"""Plane-sweep stereo by Triton against its definition, and what is known of its results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from pretended_device import pretended
from stereo_cases import LIMITS, PENALTIES, REFUSED, case, depths, plane_beside, share_of_differing, shifted
from tolerances import FLAT_SCORE, FLOAT32_GRADIENT, FLOAT32_VALUE, STEREO_AT_A_BORDER

from dofbench.runtime.ops import load


def gpu(function: str = "stereo") -> Callable[..., Any]:
    return load("stereo", "gpu", function=function)


def definition(function: str = "stereo") -> Callable[..., Any]:
    return load("stereo", "reference", function=function)


def assert_swept(given: tuple[torch.Tensor, ...], **options: int) -> None:
    """That the scores are the definition's, and where its best plane is ahead, that it is the best one too."""
    found, expected = gpu()(*given, **options), definition()(*(one.double() for one in given), **options)
    assert share_of_differing(found, expected) < STEREO_AT_A_BORDER
    if expected.shape[2] > 1:
        first, second = expected.topk(2, dim=2).values.unbind(2)
        ahead = first - second > 2 * FLOAT32_GRADIENT
        differ = (found.argmax(2) != expected.argmax(2)) & ahead
        assert float(differ.float().mean()) < STEREO_AT_A_BORDER


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
def test_the_sweep_is_the_definition(size: tuple[int, int], sources: int, planes: int, radius: int, best: int) -> None:
    assert_swept(case(*size, sources, planes, seed=1), radius=radius, best=best)


def test_sources_of_another_size() -> None:
    reference, _, maps, disparities = case(6, 7, 2, 2, seed=2)
    assert_swept((reference, torch.rand(2, 9, 5), maps, disparities), radius=1, best=2)
    assert_swept((reference, torch.rand(2, 1, 1), maps, disparities), radius=1, best=1)


def test_pixels_behind_a_camera_and_in_its_plane() -> None:
    """Coordinates that are infinite, not a number, or those of points behind the camera, in one source of three each:
    of all pixels, of one column, of all pixels."""
    reference, sources, maps, disparities = case(6, 8, 3, 2, seed=3)
    maps[0] = 0.0
    maps[1, 2] = torch.tensor([1.0, 0.0, -3.5, 0.0])
    maps[2] *= -1.0
    assert_swept((reference, sources, maps, disparities), radius=1, best=2)
    assert (gpu()(reference, sources[::2], maps[::2], disparities, radius=1, best=2) == 0).all()


def test_a_flat_image_matches_nothing() -> None:
    flat = torch.full((9, 9), 0.7)
    assert gpu()(flat, flat[None], torch.eye(3, 4)[None], torch.ones(2), radius=3, best=1).abs().max() < FLAT_SCORE


def test_a_pixel_that_no_source_sees_scores_as_unrelated_patches_do() -> None:
    image, maps = torch.rand(5, 6), torch.eye(3, 4)[None].clone()
    maps[0, 0, 2] = 100.0
    assert (gpu()(image, image[None], maps, torch.ones(2), radius=1, best=1) == 0).all()


def test_planes_swept_in_parts_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    from dofbench.runtime.ops.stereo import gpu as backend

    given = case(4, 5, 2, 3, seed=0)
    whole = gpu()(*given, radius=1, best=2)
    monkeypatch.setattr(backend, "SCRATCH", 1)
    assert torch.equal(gpu()(*given, radius=1, best=2), whole)


def test_a_shifted_image_matches_at_its_shift() -> None:
    image, sources, maps = shifted(8, 20)
    scores = gpu()(image, sources, maps, torch.arange(2.0, 5.0), radius=2, best=1)
    plane, score, margin = gpu("semiglobal")(scores, image, **PENALTIES)
    inner = slice(2, -2), slice(4, -6)
    assert (scores[inner].argmax(-1) == 1).all() and (plane[inner] - 1).abs().max() < 0.2
    assert torch.equal(score[inner], scores[inner][..., 1])
    assert margin.isinf().all()  # three planes have none at a distance from the best


# The last has more planes than a warp holds.
@pytest.mark.parametrize("size", [(6, 7, 9), (1, 1, 1), (3, 4, 2), (5, 1, 17), (1, 6, 3), (2, 2, 130)])
def test_paths_are_the_definition(size: tuple[int, int, int]) -> None:
    scores, guide = torch.rand(size), torch.rand(size[:2])
    expected = definition("semiglobal")(scores.double(), guide.double(), **PENALTIES)
    for one, other in zip(gpu("semiglobal")(scores, guide, **PENALTIES), expected, strict=True):
        assert torch.allclose(one.double(), other, atol=FLOAT32_GRADIENT)


def test_the_first_of_equally_good_planes_is_chosen() -> None:
    """Two planes that mirror each other, so that their costs are equal to the bit."""
    scores, guide = torch.zeros(3, 4, 9), torch.rand(3, 4)
    scores[..., 2] = scores[..., 6] = 1.0
    plane, score, margin = gpu("semiglobal")(scores, guide, **PENALTIES)
    assert (plane == 2).all() and (score == 1).all() and (margin == 0).all()


@pytest.mark.parametrize(
    ("fine", "coarse"), [((7, 9, 6), (3, 4, 3)), ((4, 5, 1), (2, 2, 1)), ((2, 3, 5), (1, 1, 1)), ((3, 2, 2), (3, 2, 5))]
)
def test_levels_are_mixed_linearly(fine: tuple[int, int, int], coarse: tuple[int, int, int]) -> None:
    scores, other = torch.rand(fine), torch.rand(coarse)
    expected = scores.double()
    definition("upsample")(expected, other.double(), 0.3)
    turned = scores.permute(2, 0, 1).clone(memory_format=torch.contiguous_format).permute(1, 2, 0)
    for found in (scores, turned):
        gpu("upsample")(found, other, 0.3)
        assert torch.allclose(found.double(), expected, atol=FLOAT32_VALUE)


@pytest.mark.parametrize(("height", "width"), [(11, 14), (1, 1), (2, 90)])
def test_returns_are_the_definition(height: int, width: int) -> None:
    given = depths(height, width, seed=4)
    found = gpu("returns")(*given, **LIMITS)
    assert found.dtype == torch.bool and torch.equal(found, definition("returns")(*given, **LIMITS))


def test_a_depth_returns_from_a_view_that_has_it_and_from_no_other() -> None:
    plane, there, back = plane_beside()
    found = gpu("returns")(plane, plane, there, back, pixels=1.0, share=0.02)
    assert found[:, :7].all() and not found[:, 7:].any()  # moved by two pixels, out of the image
    for other in (1.1 * plane, 0 * plane):
        assert not gpu("returns")(plane, other, there, back, pixels=1.0, share=0.02).any()


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_what_cannot_be_swept_is_refused(change: Callable[..., Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gpu()(*change(*case(9, 9, 2, 3, 0)), radius=2, best=1)


def test_another_type_is_refused() -> None:
    reference, sources, maps, disparities = case(3, 3, 1, 1, seed=0)
    with pytest.raises(ValueError, match="stereo sources: expected float32"):
        gpu()(reference, sources.double(), maps, disparities, radius=1, best=1)


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
