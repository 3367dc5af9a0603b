"""Halves of a photograph, and scores over them, against definitions written out pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.similarity import ssim_map
from dofbench.evaluation.metrics import score_image
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr, shrink, tiled_ssim


@given(st.integers(16, 90), st.integers(16, 90))
def test_every_pixel_is_of_one_half_and_none_is_scored_near_the_other(height: int, width: int) -> None:
    tiles = Tiles.of(height, width)
    assert np.array_equal(tiles.fitted, tiles.half == 0)
    if not (tiles.half == 1).any():  # a single tile
        return
    assert not (tiles.scored & tiles.fitted).any() and tiles.scored.any()
    assert np.array_equal(Tiles.of(height, width, both=True).scored, tiles.inside)
    if not (tiles.inside & (tiles.half == 1)).any():  # a sliver of a tile
        return
    margin = max(1, round(tiles.side / 8))
    rows, columns = np.nonzero(tiles.scored)
    for dy, dx in ((margin, 0), (-margin, 0), (0, margin), (0, -margin)):
        y, x = rows + dy, columns + dx
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        assert tiles.half[y[inside], x[inside]].all()


def test_a_tile_is_an_eighth_of_the_shorter_side_but_holds_a_window() -> None:
    assert Tiles.of(189, 252).side == 24 and Tiles.of(48, 64).side == 16
    # Both halves are about as large.
    assert abs(Tiles.of(189, 252).half.mean() - 0.5) < 0.05


def test_a_shrunk_cell_is_of_a_half_only_as_a_whole() -> None:
    tiles = Tiles.of(100, 130)
    expected = [
        [bool((tiles.half[3 * y : 3 * y + 3, 3 * x : 3 * x + 3] == 0).all()) for x in range(43)] for y in range(33)
    ]
    assert np.array_equal(tiles.shrunk(3), expected)
    image = np.random.default_rng(0).random((100, 130, 3))
    assert shrink(image, 3)[4, 5] == pytest.approx(image[12:15, 15:18].mean((0, 1)), abs=FLOAT64_VALUE)


def test_psnr_over_some_pixels_is_psnr_of_these() -> None:
    random = np.random.default_rng(1)
    one, two = random.random((40, 50, 3)), random.random((40, 50, 3))
    mask = random.random((40, 50)) < 0.3
    expected = score_image(one[mask][None], two[mask][None], ["psnr"])["psnr"]
    assert masked_psnr(one, two, mask) == pytest.approx(expected, abs=FLOAT64_VALUE)
    assert masked_psnr(one, one, mask) == np.inf
    with pytest.raises(ValueError, match="no pixel|none"):
        masked_psnr(one, two, mask & False)


@pytest.mark.parametrize("both", [False, True])
def test_ssim_takes_the_windows_that_lie_in_one_scored_tile(both: bool) -> None:
    random = np.random.default_rng(2)
    one, two = random.random((48, 70, 3)), random.random((48, 70, 3))
    tiles = Tiles.of(48, 70, both=both)
    similarity, values = ssim_map(one, two), []
    for y in range(similarity.shape[0]):
        for x in range(similarity.shape[1]):
            touched = {(row // tiles.side, column // tiles.side) for row in (y, y + 10) for column in (x, x + 10)}
            if len(touched) == 1 and (both or sum(next(iter(touched))) % 2 == 1):
                values.append(similarity[y, x])
    assert tiled_ssim(one, two, tiles) == pytest.approx(np.mean(values), abs=FLOAT64_VALUE)
