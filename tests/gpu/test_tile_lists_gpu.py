"""Which Gaussians are listed for which tiles on a GPU, against an ellipse drawn pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from random_gaussians import scene, turned, view

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.runtime.ops.rasterize.gpu_inputs import TILE, Settings
from dofbench.runtime.ops.rasterize.gpu_lists import Lists, project_and_list
from dofbench.runtime.ops.rasterize.op import NAMES, View


def listed(gaussians: dict[str, torch.Tensor], camera: Camera, points: np.ndarray | None = None) -> Lists:
    settings = Settings(View(camera, None, 0, None, 0.1, True, 0, 0.2), points, torch.device("cpu"))
    parameters = tuple(gaussians[name] for name in NAMES)
    return project_and_list(settings, None, gaussians.get("radius"), parameters)


def reached(lists: Lists, camera: Camera, i: int, shift: tuple[float, float], fine: int, slack: float) -> set[int]:
    """The tiles that hold a place where Gaussian i counts, its exponent's threshold lowered by `slack`, of fine * fine
    places in each pixel."""
    mx, my, l11, l21, l22, opacity, limit = lists.records[i, :7].double().tolist()
    dx = (np.arange(camera.width * fine) + 0.5) / fine - mx - shift[0]
    dy = ((np.arange(camera.height * fine) + 0.5) / fine - my - shift[1])[:, None]
    rows, columns = np.nonzero(opacity - (l11 * dx + l21 * dy) ** 2 - (l22 * dy) ** 2 >= limit - slack)
    return set((rows // (TILE * fine) * -(-camera.width // TILE) + columns // (TILE * fine)).tolist())


@pytest.mark.parametrize("needles", [False, True])
@pytest.mark.parametrize("points", [None, np.array([[0.0, 0.0], [-0.6, 0.8]])])
def test_each_tile_lists_the_gaussians_that_reach_it_nearest_first(needles: bool, points: np.ndarray | None) -> None:
    gaussians, camera = scene(40, 3, rest=0), view(150, 90)
    if needles:
        gaussians["log_scales"] = torch.tensor([[0.0, -4.0, -4.0]]).repeat(40, 1)
        gaussians["opacity_logits"] += 4
    gaussians["radius"] = torch.linspace(-20, 20, 40)
    if points is None:
        del gaussians["radius"]
    lists = listed(gaussians, camera, points)
    tiles = -(-camera.width // TILE) * -(-camera.height // TILE)
    depths = gaussians["means"] @ torch.tensor(camera.world_to_camera[2, :3]).float()
    shifts = torch.zeros(1, 40, 2)
    if points is not None:
        shifts = gaussians["radius"][:, None] * torch.tensor(points).float()[:, None]
    found = 0
    for number, shift in enumerate(shifts):
        of_tiles = [
            lists.ids[lists.starts[t] : lists.starts[t + 1]].tolist()
            for t in range(number * tiles, (number + 1) * tiles)
        ]
        for ids in of_tiles:
            assert depths[ids].tolist() == sorted(depths[ids].tolist()) and len(set(ids)) == len(ids)
        for i in range(40):
            met = {tile for tile, ids in enumerate(of_tiles) if i in ids}
            if lists.radii[i] > 0:
                # Every tile with a pixel that it draws, and none that the ellipse itself doesn't reach.
                place = shift[i].tolist()
                assert reached(lists, camera, i, place, 1, 0.0) <= met <= reached(lists, camera, i, place, 8, 0.1)
                found += len(met)
            else:
                assert not met
    assert found == len(lists.ids) > 100


def test_more_tiles_than_a_short_number_counts() -> None:
    """A picture one pixel wide and 37 500 tiles high, with a Gaussian in its first and in its last tile."""
    camera = Camera(1, 600_000, 1e6, 1e6, 0.5, 8.0, np.eye(4))
    gaussians = {name: value[:2].contiguous() for name, value in scene(2, 0, rest=0).items()}
    gaussians["means"] = torch.tensor([[0.0, (600_000 - 16) / 1e6, 1.0], [0.0, 0.0, 1.0]])
    gaussians["log_scales"], gaussians["opacity_logits"] = torch.full((2, 3), math.log(1e-6)), torch.zeros(2)
    lists = listed(gaussians, camera)
    at_first, at_last = (lists.ids[lists.starts[k] : lists.starts[k + 1]].tolist() for k in (0, 37_499))
    assert at_first == [1] and at_last == [0]
    assert lists.starts.shape == (37_501,) and int(lists.starts[-1]) == len(lists.ids)


def test_the_neighbour_in_the_list_of_a_tile_that_holds_many() -> None:
    """More Gaussians than a program projects, and more intersections than one lists."""
    gaussians = scene(300, 5, rest=0)
    gaussians["means"][:, :2] *= 0.1
    lists = listed(gaussians, view(16, 16))
    depths = (gaussians["means"] @ torch.tensor(turned()[2, :3]).float())[lists.ids]
    assert int(lists.visible.sum()) == len(lists.ids) == len(set(lists.ids.tolist())) > 256 / 2
    assert torch.equal(depths, depths.sort().values)


def test_more_intersections_than_can_be_numbered_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dofbench.runtime.ops.rasterize.gpu_lists.BAD", 30)
    with pytest.raises(InputError, match=r"places where Gaussians meet tiles, expected fewer than 30: fewer Gauss"):
        listed(scene(60, 3, rest=0), view())
