"""Launches of kernels that Triton has compiled before go past its search for what it compiled."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from dofbench.runtime import gpu_launch


class Compiled:
    """Stands for what Triton compiles: it writes down the grid and the arguments of its launches."""

    packed_metadata = ()

    def __init__(self) -> None:
        self.launches: list[tuple[Any, ...]] = []

    def __getitem__(self, grid: tuple[int, int, int]) -> Any:
        return lambda *arguments: self.launches.append((grid, *arguments))


class Kernel:
    """Stands for a kernel of Triton's: `searched` counts the launches that it had to look for."""

    arg_names = ("values", "count", "rate", "BLOCK")
    fn = SimpleNamespace(__module__="made_up", __name__="kernel")

    def __init__(self) -> None:
        self.made: list[Compiled] = []

    def __getitem__(self, grid: tuple[int, ...]) -> Any:
        def launched(*arguments: Any, **constants: Any) -> Compiled:
            self.made.append(Compiled())
            return self.made[-1]

        return launched


VALUES = torch.zeros(64)


@pytest.mark.parametrize(
    "change, searched",
    [
        ({}, 1),
        ({"values": torch.ones(8)}, 1),  # other numbers, of the same type
        ({"values": VALUES[1:]}, 2),  # doesn't begin at a multiple of 16 bytes
        ({"values": VALUES[4:]}, 1),
        ({"values": VALUES.double()}, 2),
        ({"count": 39}, 1),
        ({"count": 48}, 2),
        ({"count": 1}, 2),
        ({"count": 2**31 + 5}, 2),
        ({"count": 2**63 + 5}, 2),
        ({"count": np.int64(37)}, 2),
        ({"rate": 0.7}, 1),
        ({"rate": 1}, 2),
        ({"BLOCK": 32}, 2),
        ({"warps": 8}, 2),
    ],
)
def test_triton_is_asked_again_where_its_code_may_differ(change: dict[str, Any], searched: int) -> None:
    kernel = Kernel()

    def launch(values: Any = VALUES, count: Any = 37, rate: Any = 0.5, BLOCK: int = 64, warps: int = 4) -> None:
        gpu_launch.launch(kernel, (3, 2), values, count, rate, warps=warps, BLOCK=BLOCK)

    launch()
    launch(**change)
    assert len(kernel.made) == searched
    if searched == 1:
        ((grid, *arguments),) = kernel.made[0].launches
        expected = {"values": VALUES, "count": 37, "rate": 0.5} | change
        assert grid == (3, 2, 1) and arguments[1:] == [expected["count"], expected["rate"], 64]
        assert arguments[0] is expected["values"]
    else:
        assert not kernel.made[0].launches


def test_large_numbers_of_several_kinds_are_not_one() -> None:
    kernel = Kernel()
    for count in (2**31 + 5, 2**31 + 16, 2**63 + 5, 2**63 + 16, 2**31 + 7, -(2**31) - 1):
        gpu_launch.launch(kernel, (3, 2), VALUES, count, 0.5, BLOCK=64)
    assert len(kernel.made) == 4


def test_constants_in_another_order_go_through_triton() -> None:
    """What is compiled takes them in the order of the parameters."""
    kernel = Kernel()
    kernel.arg_names = ("values", "FIRST", "SECOND")
    for _ in range(2):
        gpu_launch.launch(kernel, (1,), VALUES, SECOND=2, FIRST=1)
    assert len(kernel.made) == 2
    for _ in range(2):
        gpu_launch.launch(kernel, (1,), VALUES, FIRST=1, SECOND=2)
    assert len(kernel.made) == 3 and kernel.made[2].launches == [((1, 1, 1), VALUES, 1, 2)]


def test_each_number_of_a_type_that_is_not_known_is_its_own() -> None:
    kernel = Kernel()
    for count in (np.int64(37), np.int64(1), np.int64(37)):
        gpu_launch.launch(kernel, (1,), VALUES, count, 0.5, BLOCK=64)
    assert len(kernel.made) == 2 and len(kernel.made[0].launches) == 1
