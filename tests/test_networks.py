"""What small networks share: encoded places, first weights, an optimiser whose rate falls."""

import math

import pytest
import torch
from tolerances import FLOAT32_SCALAR
from torch import nn

from dofbench.training.common.networks import NetworkAdam, encoded_places, in_a_row, rectified, redraw


def test_encoded_places() -> None:
    found = encoded_places(torch.tensor([[0.3, -1.0]]), 2)[0].tolist()
    waves_of = [wave(k * value) for wave in (math.sin, math.cos) for k in (1, 2) for value in (0.3, -1.0)]
    assert sorted(found) == pytest.approx(sorted([0.3, -1.0, *waves_of]), rel=FLOAT32_SCALAR)


def test_the_first_step_is_the_rate_whatever_the_gradient_is() -> None:
    """Adam divides a gradient by its own size: the first step is the rate, which falls to `final` times itself."""
    for progress, cooldown, expected in ((0.0, 1.0, 0.1), (1.0, 1.0, 0.02), (0.5, 0.5, 0.5 * 0.1 * math.sqrt(0.2))):
        weight = nn.Parameter(torch.tensor([1.0, -2.0]))
        adam = NetworkAdam([("weight", weight)], 0.1, 0.2)
        (weight * torch.tensor([3.0, -70.0])).sum().backward()
        assert adam.gradients()["weight"] is not None
        adam.step(progress, cooldown)
        assert weight.tolist() == pytest.approx([1 - expected, -2 + expected], rel=FLOAT32_SCALAR)
        assert adam.gradients()["weight"] is None
        adam.step(progress, cooldown)  # without a gradient nothing moves
        assert weight.tolist() == pytest.approx([1 - expected, -2 + expected], rel=FLOAT32_SCALAR)


def test_weights_come_from_the_generator_alone() -> None:
    def drawn(seed: int) -> list[torch.Tensor]:
        network = nn.Sequential(nn.Linear(9, 4), nn.ReLU(), nn.Conv2d(3, 5, 3))
        redraw(network, torch.Generator().manual_seed(seed))
        return [parameter.detach() for parameter in network.parameters()]

    first, again, other = drawn(1), drawn(1), drawn(2)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(first, other, strict=True))
    bounds = [1 / 3, 1 / 3, 27**-0.5, 27**-0.5]  # 1 / sqrt(inputs), of weights and of biases
    assert all(bool((values.abs() <= bound).all()) for values, bound in zip(first, bounds, strict=True))
    assert float(first[0].abs().max()) > 0.8 / 3


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("also", [True, False])
def test_a_rectified_layer_is_the_layer_cut_at_zero(bias: bool, also: bool) -> None:
    layer = nn.Linear(3, 5, bias=bias)
    inputs = torch.randn(4, 3, requires_grad=True)
    more = torch.randn(5, requires_grad=True) if also else None
    leaves = [inputs, *layer.parameters(), *([] if more is None else [more])]
    plain = (layer(inputs) + (0 if more is None else more)).clamp_min(0)
    found = rectified(layer, inputs, more)
    torch.testing.assert_close(found, plain, rtol=FLOAT32_SCALAR, atol=FLOAT32_SCALAR)
    weights = torch.randn(4, 5)
    for one, other in zip(
        torch.autograd.grad((plain * weights).sum(), leaves),
        torch.autograd.grad((found * weights).sum(), leaves),
        strict=True,
    ):
        torch.testing.assert_close(other, one, rtol=FLOAT32_SCALAR, atol=FLOAT32_SCALAR)


def test_the_gradient_in_a_row_holds_every_parameter_that_has_one():
    network = torch.nn.Linear(2, 3)
    adam = NetworkAdam(network.named_parameters(), 0.1, 1.0)
    assert adam.gradient() is None
    network(torch.tensor([1.0, 2.0]))[1].backward()
    assert adam.gradient().tolist() == [0, 0, 1, 2, 0, 0, 0, 1, 0]
    assert in_a_row([None, adam.gradient(), torch.tensor([[7.0]])]).tolist()[-1] == 7
    assert in_a_row([None]) is None


def test_a_step_that_is_not_cooled_down_is_the_whole_rate() -> None:
    weight = nn.Parameter(torch.tensor([1.0]))
    adam = NetworkAdam([("weight", weight)], 0.1, 0.2)
    (3 * weight).sum().backward()
    adam.step(0.0)
    assert weight.tolist() == pytest.approx([0.9], rel=FLOAT32_SCALAR)
