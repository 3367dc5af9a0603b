"""Lists of numbers: one word of the command line, 0.2,0.5,0.8, and a tuple from there on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec

from dofbench.core.errors import InputError


def number_list(option: str) -> PrimitiveConstructorSpec[tuple[float, ...] | None]:
    """How the command line reads and shows an option such as --focus, whose field it annotates: a tuple of floats.

    A default of None is shown; typed, it is no list.
    """
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="FLOAT,FLOAT,...",
        instance_from_str=lambda words: _parsed(option, words[0]),
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda values: ["None" if values is None else ",".join(map(repr, values))],
    )


def spelled(values: Sequence[float]) -> str:
    """The list as one word, each number as short as it goes to six digits."""
    return ",".join(f"{value:g}" for value in values)


def numbers(option: str, values: Any) -> tuple[float, ...]:
    """The values as floats. Raises InputError for what is no tuple or list of numbers, as text that wasn't parsed."""
    listed = isinstance(values, tuple | list) and len(values) > 0
    if not listed or not all(isinstance(value, float | int) for value in values):
        raise InputError(option, repr(values), "a tuple of numbers, such as (0.2, 0.5)")
    return tuple(float(value) for value in values)


def _parsed(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(entry) for entry in text.split(","))
    except ValueError:
        raise InputError(option, repr(text), "numbers separated by commas, such as 0.2,0.5") from None
