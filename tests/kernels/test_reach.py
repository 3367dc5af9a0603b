"""Computations are limited by the largest radius: how far sources are followed, and which tiles list a Gaussian."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import frontal
from random_gaussians import cpu, reference

from dofbench.runtime.ops.rasterize import cpu as rasterizer
from dofbench.runtime.ops.rasterize import cpu_layout as layout
from dofbench.runtime.ops.scatter.cpu_pack import BLOCK, geometry, pack_sources

ALPHA, HEIGHT, WIDTH = 4.0, 40, 64
CAMERA = frontal(96, 80, 100.0)


# ---- the scatter's windows ----


@given(st.floats(0, 500), st.floats(0, 500))
def test_windows_are_as_wide_as_the_largest_radius_asks_for(one: float, other: float) -> None:
    less, more = (geometry(2000, 2000, radius, ALPHA, 1.0, 0.5) for radius in sorted((one, other)))
    assert less.reach_x <= more.reach_x and less.reach_y <= more.reach_y
    for largest, sizes in ((min(one, other), less), (max(one, other), more)):
        assert sizes.reach_x == sizes.reach_y == math.ceil(max(largest + sizes.band, sizes.least))


def test_no_window_is_wider_than_the_image() -> None:
    sizes = geometry(HEIGHT, WIDTH, 1e6, ALPHA, 1.0, 0.5)
    assert (sizes.reach_y, sizes.reach_x) == (HEIGHT - 1, WIDTH - 1)


def test_one_far_reaching_source_widens_the_windows_of_its_own_block_alone() -> None:
    radius = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    radius[7, 21] = -30.0
    sizes = geometry(HEIGHT, WIDTH, 30.0, ALPHA, 1.0, 0.5)
    image = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    _, reach = pack_sources(image, radius, sizes, True, np.float32(2 * ALPHA), np.float32(15.0), True)
    blocks = reach[:, sizes.pad // BLOCK : (sizes.pad + WIDTH) // BLOCK]
    own = np.zeros(blocks.shape, bool)
    own[7, 21 // BLOCK] = True
    assert blocks[own] == np.float32(30 + sizes.band)
    assert (blocks[~own] == np.float32(max(0.5 + sizes.band, sizes.least))).all()


# ---- the rasteriser's tiles ----


@pytest.fixture
def listed(monkeypatch: pytest.MonkeyPatch):
    """`listed(**scene)`: for each tile, row by row, the Gaussians that the compiled kernel lists for it."""
    fill = rasterizer.fill_tiles

    def tiles(**scene) -> list[list[int]]:
        found = []

        def kept(*args):
            found.append(fill(*args))
            return found[-1]

        monkeypatch.setattr(rasterizer, "fill_tiles", kept)
        cpu(**scene, camera=CAMERA)
        starts, ids = found[0][:2]
        columns, rows = -(-CAMERA.width // layout.TILE_WIDTH), -(-CAMERA.height // layout.TILE_HEIGHT)
        return [ids[starts[tile] : starts[tile + 1]].tolist() for tile in range(columns * rows)]

    return tiles


def _two(blur: tuple[float, float]) -> dict[str, torch.Tensor]:
    """Two round Gaussians of two pixels, left and right of the middle; blur: variances in pixels squared."""
    size = math.log(2.0 * 4.0 / 100.0)
    return {
        "means": torch.tensor([[-0.8, 0.0, 4.0], [0.8, 0.0, 4.0]]),
        "log_scales": torch.full((2, 3), size),
        "quaternions": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(2, 1),
        "opacity_logits": torch.full((2,), 2.0),
        "sh_dc": torch.zeros(2, 3),
        "sh_rest": torch.zeros(2, 0, 3),
        "blur": torch.tensor(blur),
    }


@pytest.mark.parametrize("variance", [0.0, 9.0, 100.0])
def test_a_gaussian_is_listed_in_the_tiles_that_it_reaches_and_in_no_other(listed, variance: float) -> None:
    scene = _two((variance, 0.0))
    tiles = listed(**scene)
    for index in range(2):
        alone = {name: value[index : index + 1] for name, value in scene.items()}
        alpha = reference(**alone, camera=CAMERA).alpha.numpy()
        reached = [
            alpha[top : top + layout.TILE_HEIGHT, left : left + layout.TILE_WIDTH].any()
            for top in range(0, CAMERA.height, layout.TILE_HEIGHT)
            for left in range(0, CAMERA.width, layout.TILE_WIDTH)
        ]
        assert [index in tile for tile in tiles] == reached


def test_blur_lengthens_the_lists_of_what_is_blurred_alone(listed) -> None:
    def listings(*blur: float) -> tuple[int, int]:
        tiles = listed(**_two(blur))
        return tuple(sum(index in tile for tile in tiles) for index in range(2))

    sharp, left, both = listings(0.0, 0.0), listings(100.0, 0.0), listings(100.0, 100.0)
    assert left[0] > sharp[0] and left[1] == sharp[1]
    assert both[0] == left[0] and both[1] > sharp[1]


def test_a_closed_lens_lists_nothing_more(listed) -> None:
    closed = _two((0.0, 0.0))
    without = {name: value for name, value in closed.items() if name != "blur"}
    assert listed(**closed) == listed(**without)
