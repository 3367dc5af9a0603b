"""Colour transforms of photographs, and clipping by the sensor."""

import json

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import options, training_set
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE, GAIN_LEARNED, RESPONSE_GRADIENT

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.training.common import losses
from dofbench.training.common.photograph_colours import ColourOptions, LearnedColours, read_colours, write_colours
from dofbench.training.common.row_adam import RowAdam
from dofbench.training.gaussians.trainer import Trainer


def _image(seed=0):
    return torch.rand(8, 12, 3, generator=torch.Generator().manual_seed(seed))


def _learned(kind, views=3):
    return LearnedColours(views, ColourOptions(colour_per_view=kind))


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_a_colour_starts_as_identity_bit_for_bit(kind):
    colours, image = _learned(kind), _image()
    assert torch.equal(colours.forward(1, image), image) and torch.equal(colours.apply(1, image), image)
    assert np.array_equal(colours.matrix(1), np.eye(3, 4))


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_gradients_are_those_of_finite_differences(kind):
    image, weight = _image(), _image(1) - 0.5
    learned = _learned(kind, 1)
    table = learned._table.values
    table[:] = 0.1 * torch.rand(table.shape, generator=torch.Generator().manual_seed(2))
    image.requires_grad_()
    (learned.forward(0, image) * weight).sum().backward()
    found, by_image = learned.gradient(), image.grad.clone()
    image.requires_grad_(False)

    def slope(tensor, place, step=1e-2):
        ends = []
        for sign in (1, -1):
            tensor[place] += sign * step
            ends.append(float((learned.apply(0, image) * weight).double().sum()))
            tensor[place] -= sign * step
        return (ends[0] - ends[1]) / (2 * step)

    for place in range(table.shape[1]):
        assert float(found[place]) == pytest.approx(slope(table, (0, place)), abs=RESPONSE_GRADIENT)
    for place in [(0, 0, 0), (3, 7, 1), (7, 11, 2)]:
        assert float(by_image[place]) == pytest.approx(slope(image, place), abs=RESPONSE_GRADIENT)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_the_mean_over_the_photographs_stays_identity(kind):
    colours, random = _learned(kind, 4), np.random.default_rng(0)
    for step in range(60):
        view = int(random.integers(4))
        (colours.forward(view, _image(step)) - 0.7).square().mean().backward()
        colours.step(view, step / 60)
    assert float(colours._table.values.abs().max()) > 0.01
    assert float(colours._table.values.mean(dim=0).abs().max()) < FLOAT32_VALUE
    if kind == "affine":
        assert np.allclose(
            np.mean([colours.matrix(view) for view in range(4)], axis=0), np.eye(3, 4), atol=FLOAT32_VALUE
        )


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_exposure_and_white_balance_are_learned(kind):
    true = np.array([[0.2, 0.1, 0.0], [-0.2, 0.0, 0.1], [0.0, -0.1, -0.1]])
    colours = LearnedColours(3, ColourOptions(colour_per_view=kind, colour_lr=2e-2))
    factors = np.exp(true) if kind == "gain" else 1 + true  # the values whose mean over the photographs is made zero
    for step in range(1500):
        view, image = step % 3, _image(step)
        photograph = image * torch.tensor(factors[view]).float()
        (colours.forward(view, image) - photograph).square().mean().backward()
        colours.step(view, step / 1500)
    for view in range(3):
        assert np.diag(colours.matrix(view)) == pytest.approx(factors[view], abs=GAIN_LEARNED)


def _pixels(count=40, views=3):
    """(numbers of photographs, colours of pixels)."""
    random = torch.Generator().manual_seed(5)
    return torch.randint(views, (count,), generator=random), torch.rand(count, 3, generator=random)


@pytest.mark.parametrize("kind", ["gain", "affine"])
def test_pixels_of_many_photographs_have_each_its_own_colour(kind):
    """Values and gradients are those of each photograph's pixels by themselves, for two predictions at once too."""
    learned, (views, colours) = _learned(kind), _pixels()
    table = learned._table.values
    table[:] = 0.2 * torch.rand(table.shape, generator=torch.Generator().manual_seed(6)) - 0.1
    both = torch.stack([colours, 1 - colours]).requires_grad_()
    found = learned.of_pixels(views, both)
    found.square().sum().backward()
    gradient = learned.gradient()
    assert gradient.shape == table.shape
    for view in range(3):
        own = both.detach()[:, views == view].requires_grad_()
        alone = learned.forward(view, own)
        alone.square().sum().backward()
        assert torch.allclose(found.detach()[:, views == view], alone.detach(), rtol=0, atol=FLOAT32_VALUE)
        assert torch.allclose(both.grad[:, views == view], own.grad, rtol=0, atol=FLOAT32_GRADIENT)
        assert torch.allclose(gradient[view], learned.gradient(), rtol=FLOAT32_GRADIENT, atol=0)


def test_steps_on_all_rows_and_on_one_are_torch_s_adam_s():
    """Each row is a parameter of its own, which steps as often as it is asked for."""
    start, random = torch.rand(4, 3, generator=torch.Generator().manual_seed(7)), np.random.default_rng(8)
    table = RowAdam(start.clone())
    rows = [row.clone().requires_grad_() for row in start]
    optimisers = [torch.optim.Adam([row], lr=1e-2, eps=1e-15) for row in rows]
    for _ in range(30):
        chosen = None if random.random() < 0.5 else int(random.integers(4))
        weight = torch.tensor(random.normal(size=(4, 3)), dtype=torch.float32)
        leaf = table.leaf(chosen)
        (leaf * (weight if chosen is None else weight[chosen])).sum().backward()
        table.step(chosen, 1e-2)
        for number in range(4) if chosen is None else [chosen]:
            rows[number].grad = weight[number]
            optimisers[number].step()
    expected = torch.stack([row.detach() for row in rows])
    assert torch.allclose(table.values, expected, rtol=0, atol=FLOAT32_VALUE)


def test_what_is_not_finite_in_a_gradient_counts_as_zero():
    """On a device nobody has looked at it before the step is taken."""
    found = []
    for bad in (torch.nan, torch.inf, 0.0):
        table = RowAdam(torch.ones(2, 3), dense=True)
        for number in (0.5, bad):
            (table.leaf(1) * torch.tensor([1.0, number, -2.0])).sum().backward()
            table.step(1, 1e-2)
        found.append(table.values)
    assert torch.equal(found[0], found[2]) and torch.equal(found[1], found[2])


def test_without_options_nothing_is_learned_and_nothing_touched():
    colours, image = _learned("off"), _image()
    assert not colours.learned
    assert colours.forward(0, image) is image and colours.apply(0, image) is image
    views, pixels = _pixels()
    assert colours.of_pixels(views, pixels) is pixels
    assert colours.gradient() is None
    colours.step(0, 0.5)
    colours.step(None, 0.5)
    assert np.array_equal(colours.matrix(0), np.eye(3, 4))


def test_photographs_of_other_colours_are_made_again():
    """Of three views one is darker and one warmer: with colour transforms each is predicted better."""
    given, errors = training_set(), {}
    factors = np.array([[0.8, 0.8, 0.8], [1.2, 1.2, 1.0], [1.04, 1.04, 1.25]], np.float32)
    views = tuple(
        type(view)(view.name, view.camera, view.image * factor * 0.8)
        for view, factor in zip(given.views, factors, strict=True)
    )
    for chosen in ("off", "gain"):
        trainer = Trainer(
            type(given)(views, given.points),
            options(steps=60, lens=False, adaptation="off", normal_weight=0, colour_per_view=chosen, colour_lr=3e-2),
            0,
        )
        trainer.fit(Budget(), Recorder())
        errors[chosen] = np.mean(
            [np.abs(trainer.render_view(index) - view.image).mean() for index, view in enumerate(views)]
        )
        assert (trainer.colour_estimates() is None) == (chosen == "off")
    assert errors["gain"] < errors["off"]
    assert trainer.colour_estimates()["v0"][0, 0] < 0.95 < trainer.colour_estimates()["v1"][0, 0]


def test_colours_are_read_as_written(tmp_path):
    colours = {"a": np.arange(12, dtype=np.float32).reshape(3, 4) / 7, "b": np.eye(3, 4, dtype=np.float32)}
    write_colours(tmp_path / "colours.json", colours)
    found = read_colours(tmp_path / "colours.json")
    assert list(found) == ["a", "b"] and all(np.array_equal(found[name], colours[name]) for name in colours)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data | {"version": 2},
        lambda data: data | {"views": {"a": [[1, 0], [0, 1]]}},
        lambda data: data | {"views": {"a": [["x"] * 4] * 3}},
        lambda data: {"schema_name": data["schema_name"]},
        lambda data: [],
        lambda data: data | {"views": {"a": [[float("nan")] * 4] * 3}},
    ],
)
def test_damaged_colours_are_one_clear_error(tmp_path, change):
    file = tmp_path / "colours.json"
    write_colours(file, {"a": np.eye(3, 4)})
    file.write_text(json.dumps(change(json.loads(file.read_text()))))
    with pytest.raises(InputError, match=r"colours\.json"):
        read_colours(file)


# ---- what the sensor clipped ----


def test_only_at_or_above_the_white_of_a_clipped_channel_the_gradient_is_cut():
    target = torch.full((16, 16, 3), 0.6)
    target[4:12, 4:12, :2] = 1.0
    prediction = torch.full((16, 16, 3), 1.3)
    prediction[:, 8:] = 0.8
    prediction.requires_grad_()
    without_held_out = losses.without_held_out(prediction, target, clipped_white=True)
    free = (target == 1) & (prediction.detach() > 1)
    assert int(free.sum()) == 8 * 4 * 2
    (without_held_out - target).abs().sum().backward()
    assert torch.equal(prediction.grad == 0, free)
    prediction.grad = None
    losses.reconstruction(losses.without_held_out(prediction, target, clipped_white=True), target, 0.4, None).backward()
    assert torch.equal(prediction.grad == 0, free)
    cost = (without_held_out - target).abs().detach()
    assert not cost[free].any() and torch.equal(cost[~free], (prediction - target).abs().detach()[~free])


def test_one_level_below_white_isn_t_clipped():
    target = torch.full((12, 12, 3), 254 / 255)
    prediction = torch.full((12, 12, 3), 1.2)
    assert torch.equal(losses.without_held_out(prediction, target, clipped_white=True), prediction)


def test_light_above_white_is_kept_where_the_blur_spreads_it():
    """The brightness of a lamp of three times white is recovered from its blur, which is below white."""
    from dofbench.optics.defocus import scatter_defocus

    sharp = torch.full((33, 33, 3), 0.2)
    sharp[15:18, 15:18] = 1.6
    radius = torch.full((33, 33), 2.0)
    photograph = scatter_defocus(sharp, radius).clamp(max=1)
    assert float(photograph.max()) == 1
    errors = {}
    for clipped in (False, True):
        image = torch.full((33, 33, 3), 0.2).requires_grad_()
        adam = torch.optim.Adam([image], lr=0.02)
        for _ in range(150):
            adam.zero_grad()
            prediction = losses.without_held_out(scatter_defocus(image, radius), photograph, clipped_white=clipped)
            (prediction - photograph).abs().mean().backward()
            adam.step()
        errors[clipped] = abs(float(image.detach()[15:18, 15:18].mean()) - 1.6)
    assert errors[True] < errors[False]
