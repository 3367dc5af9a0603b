"""Adam's step: its definition beside torch's optimiser, and the CPU's backend beside both."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE
from torch import Tensor

from dofbench.runtime.ops import load

RATE, EPSILON = 0.03, 1e-9


def begun(dtype: torch.dtype, count: int = 1500) -> tuple[Tensor, list[Tensor]]:
    """Values, and the gradients of four steps, of many magnitudes."""
    random = torch.Generator().manual_seed(0)
    values = torch.randn(count, generator=random, dtype=torch.float64)
    sizes = 10 ** (8 * torch.rand(4, count, generator=random, dtype=torch.float64) - 6)
    gradients = sizes * torch.randn(4, count, generator=random, dtype=torch.float64)
    return values.to(dtype), list(gradients.to(dtype))


def steps(backend: str, dtype: torch.dtype, rate: float = RATE) -> list[Tensor]:
    """The values after each step."""
    values, gradients = begun(dtype)
    moments = torch.zeros_like(values), torch.zeros_like(values)
    found = []
    for step, gradient in enumerate(gradients, 1):
        load("adam", backend)(
            [values], [gradient], *([one] for one in moments), steps=[step], lrs=[rate * step], eps=EPSILON
        )
        found.append(values.clone())
    return found


def steps_of_torch(dtype: torch.dtype, **kind: bool) -> list[Tensor]:
    values, gradients = begun(dtype)
    values.requires_grad_()
    optimiser = torch.optim.Adam([values], eps=EPSILON, **kind)
    found = []
    for step, gradient in enumerate(gradients, 1):
        optimiser.param_groups[0]["lr"] = RATE * step
        values.grad = gradient
        optimiser.step()
        found.append(values.detach().clone())
    return found


def test_the_definition_is_adam() -> None:
    """By torch's plain optimiser in float64."""
    for found, expected in zip(steps("reference", torch.float64), steps_of_torch(torch.float64), strict=True):
        torch.testing.assert_close(found, expected, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)


def test_the_cpu_s_is_torch_s_fused_one_to_the_bit() -> None:
    for found, expected in zip(steps("cpu", torch.float32), steps_of_torch(torch.float32, fused=True), strict=True):
        assert torch.equal(found, expected)


def test_the_cpu_s_agrees_with_the_definition() -> None:
    for found, expected in zip(steps("cpu", torch.float32), steps("reference", torch.float64), strict=True):
        assert float((found - expected).abs().max()) < FLOAT32_VALUE * float(expected.abs().max())


@dataclass
class Several:
    """Arguments of a step on tensors of several shapes and numbers of steps, one with a gradient by two of its rows."""

    values: list[Tensor]
    gradients: list[Tensor]
    exp_avgs: list[Tensor]
    exp_avg_sqs: list[Tensor]
    rows: list[int]
    steps: list[int]
    lrs: list[float]

    @staticmethod
    def drawn(dtype: torch.dtype) -> Several:
        random = torch.Generator().manual_seed(1)
        shapes = [(1500,), (7, 4), (3, 2, 2), (1,), (9, 3), (0, 5), (2050,), (40, 1)]
        made = [[torch.rand(shape, generator=random).to(dtype) for shape in shapes] for _ in range(4)]
        made[1][4] = made[1][4][:2]
        rows = [6 if number == 4 else 0 for number in range(len(shapes))]
        steps = [1 + number for number in range(len(shapes))]
        return Several(*made, rows, steps, [0.01 * step for step in steps])

    def step(self, backend: str, only: int | None = None, **options: object) -> list[Tensor]:
        """What is moved by a step on all, or on one of them alone."""
        some = slice(None) if only is None else slice(only, only + 1)
        moved = [one[some] for one in (self.values, self.exp_avgs, self.exp_avg_sqs)]
        load("adam", backend)(
            moved[0], self.gradients[some], *moved[1:],
            steps=self.steps[some], lrs=self.lrs[some], rows=self.rows[some], eps=EPSILON, **options,
        )  # fmt: skip
        return [one for each in moved for one in each]


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_a_step_on_several_tensors_is_one_on_each(backend: str) -> None:
    """To the bit; and rows without a gradient have one of 0."""
    together, alone = Several.drawn(torch.float32), Several.drawn(torch.float32)
    alone.gradients[4] = torch.cat([torch.zeros(6, 3), alone.gradients[4], torch.zeros(1, 3)])
    alone.rows[4] = 0
    together.step(backend)
    for number in range(len(alone.values)):
        alone.step(backend, number)
    for name in ("values", "exp_avgs", "exp_avg_sqs"):
        assert all(map(torch.equal, getattr(together, name), getattr(alone, name)))


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_what_is_not_finite_counts_as_zero_if_it_is_to_be_finite(backend: str) -> None:
    moved = []
    for bad in ((torch.nan, torch.inf, -torch.inf), (0.0, 0.0, 0.0)):
        several = Several.drawn(torch.float32)
        several.gradients[0][3:6] = several.gradients[4][1] = torch.tensor(bad)
        moved.append(several.step(backend, finite=bad[0] != 0))
    assert all(map(torch.equal, *moved))


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_a_scalar_that_is_one_has_nothing_changed(backend: str) -> None:
    values, (gradient, *_) = begun(torch.float32)
    tensors = values, gradient, torch.full_like(values, 0.5), torch.full_like(values, 0.25)
    before = [tensor.clone() for tensor in tensors]
    arguments, options = [[tensor] for tensor in tensors], {"steps": [1], "lrs": [RATE], "eps": EPSILON}
    gradient[7] = torch.nan
    load("adam", backend)(*arguments, **options, found_inf=torch.ones(()))
    assert all(torch.equal(*pair) for k, pair in enumerate(zip(tensors, before, strict=True)) if k != 1)
    gradient[7] = 0.0
    load("adam", backend)(*arguments, **options, found_inf=torch.zeros(()))
    assert not any(torch.equal(*pair) for k, pair in enumerate(zip(tensors, before, strict=True)) if k != 1)


def test_wrong_arguments_are_named() -> None:
    values = torch.zeros(3)
    call = load("adam")
    usual = {"steps": [1], "lrs": [1.0], "eps": 0.0}
    with pytest.raises(ValueError, match=r"^adam exp_avg_sq: expected shape \(3,\), found \(4,\)$"):
        call([values], [values], [values], [torch.zeros(4)], **usual)
    with pytest.raises(ValueError, match=r"^adam grad: expected shape \(3,\), found \(4,\)$"):
        call([values], [torch.zeros(4)], [values], [values], **usual)
    with pytest.raises(ValueError, match=r"^adam grad: expected rows of \(3,\) from row 2 on, found \(2,\)$"):
        call([values], [values[:2]], [values], [values], **usual, rows=[2])
    with pytest.raises(ValueError, match=r"^adam: expected a step of at least 1, found 0$"):
        call(*[[values]] * 4, **{**usual, "steps": [0]})
    with pytest.raises(ValueError, match=r"^adam: expected 1 of each argument, found \[1, 1, 1, 1, 2, 1, 1\]$"):
        call(*[[values]] * 4, **{**usual, "steps": [1, 2]})
    with pytest.raises(ValueError, match=r"^kernel adam, backend cpu: found float64 on cpu, expected float32 on cpu$"):
        load("adam", "cpu")(*[[values.double()]] * 4, **usual)
