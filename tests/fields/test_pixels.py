"""Pixels are drawn without repetition, and their rays are those of their cameras."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import torch
from made_up import frontal
from tolerances import FLOAT32_POINT, FLOAT32_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingView
from dofbench.core.images import from_8bit
from dofbench.training.fields.pixels import CameraTable, TrainingPixels, whole_image


def turned() -> Camera:
    angle = 0.4
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = 0.3, -0.2, 0.5
    return Camera(5, 4, 6.0, 7.0, 2.2, 2.1, pose)


def views() -> list[TrainingView]:
    """Two sizes; a pixel's colour says where it is: view, row, column."""
    found = []
    for index, camera in enumerate((frontal(3, 2, 4.0), turned())):
        rows, columns = np.mgrid[: camera.height, : camera.width]
        image = np.stack([np.full(rows.shape, index), rows, columns], axis=2).astype(np.float32)
        found.append(TrainingView(f"v{index}", camera, image))
    return found


def test_every_pixel_is_drawn_once_in_a_round() -> None:
    pixels = TrainingPixels(views(), np.random.default_rng(0))
    rounds = []
    for _ in range(2):
        drawn = [pixels.draw(13), pixels.draw(13)]  # 6 + 20 pixels
        for part in drawn:
            expected = torch.stack([part.views, part.places[:, 1] - 0.5, part.places[:, 0] - 0.5], 1)
            assert torch.equal(part.colours, expected.float())
        colours = [tuple(row) for part in drawn for row in part.colours.tolist()]
        assert len(set(colours)) == 26
        rounds.append(colours)
    assert rounds[0] != rounds[1]


def test_rays_meet_what_a_pixel_shows() -> None:
    cameras = [view.camera for view in views()]
    points = np.array([[0.1, 0.2, 3.0], [-0.3, 0.1, 5.0]])
    table = CameraTable(cameras)
    for index, camera in enumerate(cameras):
        xy, depth = camera.project(points)
        origins, directions = table.rays(torch.full((2,), index), torch.from_numpy(xy).float())
        met = origins + torch.from_numpy(depth).float()[:, None] * directions
        np.testing.assert_allclose(met.numpy(), points, atol=FLOAT32_POINT)


def test_a_shift_is_along_the_camera_s_axes() -> None:
    camera = turned()
    shift = torch.tensor([[0.2, -0.1]])
    origins, _ = CameraTable([camera]).rays(torch.zeros(1).long(), torch.tensor([[1.0, 2.0]]), shift)
    local = camera.world_to_camera[:3, :3] @ origins[0].double().numpy() + camera.world_to_camera[:3, 3]
    np.testing.assert_allclose(local, [0.2, -0.1, 0], atol=FLOAT32_VALUE)


def test_a_whole_image_is_row_after_row() -> None:
    places = whole_image(frontal(3, 2, 4.0))
    assert places.tolist() == [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5], [1.5, 1.5], [2.5, 1.5]]


def test_one_photograph_at_a_time_in_rounds() -> None:
    pixels = TrainingPixels(views(), np.random.default_rng(0))
    for _ in range(3):
        drawn = [pixels.draw_view(4) for _ in range(2)]
        assert {int(part.views[0]) for part in drawn} == {0, 1}
        for part in drawn:
            assert len(part.views) == 4 and len(set(part.views.tolist())) == 1
            assert len({tuple(row) for row in part.places.tolist()}) == 4
    assert len(pixels.draw_view(99).views) in (6, 20)


def test_a_patch_is_a_rectangle_row_after_row() -> None:
    pixels = TrainingPixels(views(), np.random.default_rng(0))
    corners = set()
    for _ in range(60):
        part = pixels.draw_patch(3)
        view = int(part.views[0])
        rows, columns = (2, 3) if view == 0 else (3, 3)  # the first photograph has but two rows
        assert len(part.views) == rows * columns
        left, top = part.places[0].tolist()
        expected = [[left + x, top + y] for y in range(rows) for x in range(columns)]
        assert part.places.tolist() == expected
        assert torch.equal(part.colours[:, 1:], part.places.flip(1) - 0.5)
        corners.add((view, left, top))
    assert corners == {(0, 0.5, 0.5), *((1, x + 0.5, y + 0.5) for x in range(3) for y in range(2))}


def masked_views():
    random = np.random.default_rng(3)
    found = []
    for view in views():
        mask = random.uniform(size=view.image.shape[:2]) < 0.3
        mask[0, 0] = True
        found.append(replace(view, mask=mask))
    return found


def test_masked_pixels_are_drawn_only_within_patches_and_have_no_error_there():
    given = masked_views()
    pixels = TrainingPixels(given, np.random.default_rng(0))

    def valid(drawn):
        at = zip(drawn.views.tolist(), drawn.places.floor().long().tolist(), strict=True)
        return np.array([given[view].mask[row, column] for view, (column, row) in at])

    for _ in range(12):
        assert valid(pixels.draw(7)).all() and valid(pixels.draw_view(9)).all()
    every = sum(int(view.mask.sum()) for view in given)
    whole = TrainingPixels(given, np.random.default_rng(0)).draw(10**6)
    assert len(whole.views) == every
    for side in (1, 3, 5):
        for _ in range(20):
            patch = pixels.draw_patch(side)
            assert patch.valid.any() and (patch.valid.numpy() == valid(patch)).all()
            predicted = torch.full_like(patch.colours, 0.123).requires_grad_()
            (patch.without_masked(predicted) - patch.colours).square().sum().backward()
            assert ((predicted.grad != 0).any(dim=1) <= patch.valid).all()


def test_the_order_goes_on_from_its_state_which_does_not_grow_with_the_pixels() -> None:
    for given in (views(), masked_views()):
        pixels, rest = TrainingPixels(given, np.random.default_rng(0)), TrainingPixels(given, np.random.default_rng(1))
        for _ in range(3):
            pixels.draw(4)
        state = pickle.dumps(pixels.state())
        assert all(not isinstance(one, np.ndarray) for one in pixels.state())
        rest.restore(pickle.loads(state))
        twin = copy.deepcopy(pixels)
        for _ in range(20):
            expected = pixels.draw(4)
            assert torch.equal(rest.draw(4).places, expected.places)
            assert torch.equal(twin.draw(4).places, expected.places)


def test_8_bit_images_have_the_colours_of_their_floats() -> None:
    random = np.random.default_rng(0)
    levels = [random.integers(0, 256, view.image.shape).astype(np.uint8) for view in views()]
    given = [replace(view, image=from_8bit(one)) for view, one in zip(views(), levels, strict=True)]
    mixed = [given[0], replace(given[1], image=given[1].image * np.float32(0.9))]
    for case in (given, mixed):
        drawn = TrainingPixels(case, np.random.default_rng(0)).draw(26)
        for view, (x, y), colour in zip(drawn.views, drawn.places.long().tolist(), drawn.colours, strict=True):
            assert colour.tolist() == case[int(view)].image[y, x].tolist()
