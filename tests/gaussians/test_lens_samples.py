"""The lens sampled at points: geometry against a camera that is really moved, blur against the scatter."""

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import (
    FEW_POINTS,
    FINITE_DIFFERENCE,
    FLOAT32_GRADIENT,
    FLOAT32_VALUE,
    LENS_MOVED_CAMERA,
    LENS_SMEAR,
    SAMPLED_PLANE,
)

from dofbench.core.cameras import Camera
from dofbench.core.lens import DisparityRange, Lens
from dofbench.runtime.raster import ViewStatistics
from dofbench.training.gaussians import lens_models
from dofbench.training.gaussians.forward_model import BlurOptions, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import (
    ScatterBlur,
    ScatterOptions,
    circles_in_view,
    mean_light,
    views_from_lens,
)
from dofbench.training.gaussians.lens_pattern import cell_variance, lens_points
from dofbench.training.gaussians.lens_renderer import LensRenderer, StillRasteriser
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise, rasterise_from_points
from dofbench.training.gaussians.training_step import summed

WIDTH, HEIGHT = 96, 72
BOUNDS = DisparityRange(0.1, 0.5)


def _camera(**changes):
    pose = np.eye(4)
    pose[:3, 3] = 0.1, -0.05, 0.2
    return Camera(
        **{
            "width": WIDTH,
            "height": HEIGHT,
            "fx": 90.0,
            "fy": 95.0,
            "cx": WIDTH / 2,
            "cy": HEIGHT / 2,
            "world_to_camera": pose,
            **changes,
        }
    )


def _scene(depths, count=3000, seed=0):
    """Opaque, coloured Gaussians on planes across the view."""
    random = np.random.default_rng(seed)
    depth = random.choice(depths, count)
    xyz = np.stack([random.uniform(-0.7, 0.7, count) * depth, random.uniform(-0.6, 0.6, count) * depth, depth], axis=1)
    pose = _camera().world_to_camera
    colours = random.uniform(0.2, 0.9, (count, 3)).astype(np.float32)
    gaussians = Gaussians.from_points(cloud(xyz - pose[:3, 3], rgb=colours), 0)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"] += 4
        gaussians.parameters["log_scales"][:] = torch.log(torch.from_numpy(depth).float() * 0.03)[:, None]
    return gaussians


LOOKS = AppearanceOptions(sh_degree=0)


def _options(**changes):
    return GaussianOptions().with_overrides({"lens_model": "samples", "sh_degree": 0, **changes})


@pytest.mark.parametrize("rings", [0, 1, 2])
def test_a_closed_lens_is_a_pinhole(rings):
    gaussians, shot = _scene([3.0, 6.0]), Shot(_camera(), BOUNDS, 0.0, 0.0)
    sharp = rasterise(gaussians, shot.camera, LOOKS).color
    for seen in views_from_lens(StillRasteriser(gaussians, LOOKS), shot, rings, to_depth=False):
        assert torch.equal(seen, sharp)


def test_a_point_of_the_lens_sees_what_a_camera_there_sees():
    """Against a camera that is moved across the lens, with its sensor shifted to keep the plane in focus in place."""
    gaussians, camera = _scene([2.5, 5.0]), _camera()
    lens = Lens(1.5, 0.4)
    shot = Shot(camera, BOUNDS, lens.aperture, -lens.aperture * lens.focus)
    views = views_from_lens(StillRasteriser(gaussians, LOOKS), shot, 1, to_depth=False)
    physical = lens.physical(BOUNDS, WIDTH)
    for seen, point in zip(views, lens_points(1), strict=True):
        offset = -physical.aperture * point / (camera.fx, camera.fy)
        pose = camera.world_to_camera.copy()
        pose[:2, 3] -= offset
        moved = _camera(
            world_to_camera=pose,
            cx=camera.cx + camera.fx * offset[0] * physical.focus_disparity,
            cy=camera.cy + camera.fy * offset[1] * physical.focus_disparity,
        )
        # A moved camera sees what a point of the lens sees; the blur of the point's cell comes on top.
        depth = gaussians.parameters["means"].detach()[:, 2] + float(shot.camera.world_to_camera[2, 3])
        blur = cell_variance(shot.radius(1 / depth), 1)
        (plain,) = rasterise_from_points(gaussians, moved, LOOKS, np.zeros((1, 2)), torch.zeros_like(blur), blur)
        middle = rasterise(gaussians, camera, LOOKS).color
        assert float((seen - plain).detach().abs().mean()) < LENS_MOVED_CAMERA
        assert float((seen - middle).detach().abs().mean()) > 4 * LENS_MOVED_CAMERA


def test_before_a_plane_it_blurs_as_the_scatter_does():
    """On a single plane there is no occlusion, so both models give the same photograph."""
    gaussians, camera = _scene([2.5], count=5000), _camera()
    lens = Lens(4.0, 0.0).physical(BOUNDS, WIDTH)
    by_samples = LensRenderer(gaussians, _options()).render(camera, lens).image
    by_scatter = LensRenderer(gaussians, _options(lens_model="scatter")).render(camera, lens).image
    sharp = LensRenderer(gaussians, _options()).render(camera, None).image
    inside = (slice(8, -8), slice(8, -8))
    assert np.abs(by_samples - by_scatter)[inside].mean() < SAMPLED_PLANE
    assert np.abs(by_samples - sharp)[inside].mean() > 4 * SAMPLED_PLANE


def test_a_sharp_foreground_hides_the_blurred_background_where_the_scatter_smears():
    """A dark near plane covers the left half and is in focus; a bright far one is blurred by up to 9 px."""
    gaussians, camera = _scene([2.0, 10.0], count=9000), _camera()
    with torch.no_grad():
        means = gaussians.parameters["means"]
        near = means[:, 2] < 5
        gaussians.parameters["sh_dc"][near], gaussians.parameters["sh_dc"][~near] = -1.4, 1.4
        gaussians.parameters["opacity_logits"][near & (means[:, 0] > 0)] = -20
    lens = Lens(12.0, float(BOUNDS.normalise(1 / 2.2))).physical(BOUNDS, WIDTH)
    sharp, by_samples, by_scatter = (
        LensRenderer(gaussians, _options(lens_model=model)).render(camera, asked).image[..., 0]
        for model, asked in (("samples", None), ("samples", lens), ("scatter", lens))
    )
    hidden = np.zeros(sharp.shape, dtype=bool)
    hidden[8:-8, 8 : WIDTH // 2 - 6] = True
    hidden &= sharp < 0.2
    assert hidden.sum() > 500
    assert np.abs(by_samples - sharp)[hidden].max() < LENS_SMEAR < np.abs(by_scatter - sharp)[hidden].max() / 2


def test_circles_are_those_of_the_gaussians_that_the_camera_sees():
    """Against each Gaussian's own projection, with Gaussians behind the camera and beside the image."""
    gaussians, camera = _scene([2.5, 5.0], count=200), _camera()
    with torch.no_grad():
        gaussians.parameters["means"][:40, 2] *= -1
        gaussians.parameters["means"][40:80, 0] += 50
    lens = Lens(1.5, 0.4)
    pixels, depth = camera.project(gaussians.parameters["means"].detach().double().numpy())
    seen = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < [WIDTH, HEIGHT]).all(axis=1)
    assert 0 < seen.sum() < 200
    expected = np.abs(lens.physical(BOUNDS, WIDTH).signed_radius(1 / depth[seen], WIDTH))
    found = circles_in_view(gaussians, Shot(camera, BOUNDS, lens.aperture, -lens.aperture * lens.focus)).numpy()
    assert (~np.isnan(found)).tolist() == seen.tolist()
    assert found[seen] == pytest.approx(expected, rel=FLOAT32_VALUE, abs=FLOAT32_VALUE)


def test_circles_count_a_gaussian_on_the_edge_that_belongs_to_the_image():
    """A pixel contains its left and its upper edge."""
    camera = frontal(4, 4, 2.0, (0.0, 0.0, 0.0))
    gaussians = Gaussians.from_points(cloud([(-1, -1, 1.0), (1, -1, 1.0), (-1, 1, 1.0), (1, 1, 1.0)]), 0)
    assert circles_in_view(gaussians, Shot(camera, BOUNDS, 1.0, 0.0)).isnan().tolist() == [False, True, True, True]


@pytest.mark.parametrize("aperture", [1.5, 4.0, 9.0])
def test_a_picture_of_few_points_is_that_of_many(monkeypatch, aperture):
    """With two planes that partly hide each other, more points would change the picture only slightly."""
    gaussians, camera, seen = _scene([2.0, 10.0], count=3000), _camera(), []
    with torch.no_grad():
        near = gaussians.parameters["means"][:, 2] < 5
        gaussians.parameters["sh_dc"][near] *= -1
        gaussians.parameters["opacity_logits"][near & (gaussians.parameters["means"][:, 0] > 0)] = -20
    lens = Lens(aperture, 0.3).physical(BOUNDS, WIDTH)
    monkeypatch.setattr(lens_models, "views_from_lens", lambda *given: seen.append(given[2]) or views_from_lens(*given))
    few = LensRenderer(gaussians, _options()).render(camera, lens).image
    monkeypatch.setattr(lens_models, "rings_for", lambda *given: 4)
    many = LensRenderer(gaussians, _options()).render(camera, lens).image
    sharp = LensRenderer(gaussians, _options()).render(camera, None).image
    assert seen[0] < seen[1] == 4
    assert np.abs(few - many).mean() < FEW_POINTS * np.abs(sharp - many).mean()


@pytest.mark.parametrize("rings", [0, 1])
def test_the_gradient_by_the_lens_is_the_difference_quotient(rings):
    """In double precision, by steps so small that no footprint's rim, where alpha jumps from 1/255 to 0, passes a
    pixel."""
    camera = _camera(width=24, height=18, fx=22.0, fy=23.0, cx=12.0, cy=9.0)
    gaussians = _scene([2.5, 6.0], count=40)
    gaussians = Gaussians({name: value.double() for name, value in gaussians.parameters.items()})
    scene = StillRasteriser(gaussians, AppearanceOptions(sh_degree=0, filter_3d=False))

    def loss(slope, offset):
        image = mean_light(views_from_lens(scene, Shot(camera, BOUNDS, slope, offset), rings, to_depth=True), 2.2)
        return (image - 0.5).square().sum()

    values = torch.tensor([8.0, -3.0], dtype=torch.float64, requires_grad=True)
    loss(values[0], values[1]).backward()
    for index in range(2):
        step = 1e-6
        with torch.no_grad():
            up, down = values.detach().clone(), values.detach().clone()
            up[index] += step
            down[index] -= step
            quotient = float(loss(*up) - loss(*down)) / (2 * step)
        assert float(values.grad[index]) == pytest.approx(quotient, rel=FINITE_DIFFERENCE)


def test_without_gradient_to_depth_the_lens_still_learns():
    gaussians, statistics = _scene([2.5, 6.0], count=300), []

    class Counted(StillRasteriser):
        def rasterise_from_points(self, camera, points, radius, blur):
            statistics.append(ViewStatistics(want_abs=True))
            assert len(points) == 5
            return rasterise_from_points(self.gaussians, camera, LOOKS, points, radius, blur, statistics=statistics[-1])

    slope = torch.tensor(0.8, requires_grad=True)
    shot = Shot(_camera(), BOUNDS, slope, -0.3)
    mean_light(views_from_lens(Counted(gaussians, LOOKS), shot, 1, to_depth=False), 2.2).square().sum().backward()
    assert float(slope.grad) != 0
    (whole,) = statistics
    assert bool((whole.abs_grad_2d >= whole.grad_2d.abs() * (1 - FLOAT32_GRADIENT)).all()) and bool(whole.visible.any())
    assert summed([whole]).visible.equal(whole.visible)


def test_a_mean_is_taken_in_linear_light():
    black, white = torch.zeros(4, 4, 3), torch.ones(4, 4, 3)
    assert mean_light(torch.stack([black, white]), 2.2).numpy() == pytest.approx(0.5 ** (1 / 2.2), abs=FLOAT32_VALUE)


def test_the_focused_plane_is_as_sharp_as_without_a_lens():
    gaussians, camera = _scene([2.5], count=2000), _camera()
    lens = Lens(1.0, float(BOUNDS.normalise(1 / 2.5))).physical(BOUNDS, WIDTH)
    image = LensRenderer(gaussians, _options()).render(camera, lens).image
    sharp = LensRenderer(gaussians, _options()).render(camera, None).image
    assert np.abs(image - sharp).max() < SAMPLED_PLANE


def test_scatter_takes_a_polygon():
    image = torch.zeros(41, 41, 3)
    image[20, 20] = 1.0
    disparity, camera = torch.full((41, 41), 0.5), _camera(width=41, height=41, cx=20.5, cy=20.5)
    shot = Shot(camera, BOUNDS, 10.0, 0.0)
    disc, triangle = (
        ScatterBlur(BlurOptions(), ScatterOptions(lens_blades=blades)).spread(image, disparity, shot)
        for blades in (0, 3)
    )
    lit = [int((picture[..., 0] > 0.5 * picture.max()).sum()) for picture in (disc, triangle)]
    assert 0.3 < lit[1] / lit[0] < 0.6  # a triangle in a circle has 41 % of its area
