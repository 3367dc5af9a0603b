"""Options of the commands: pydantic dataclasses whose validation errors are one-line InputErrors.

    @options()
    class Walk:
        days: Annotated[int, Field(ge=1)] = 1
        speeds: NumberList[Annotated[float, Field(gt=0)]] = (4.5,)

The command line, which prints every ValueError in a frame of its own, builds them within `unframed_errors`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import field, fields
from typing import Annotated, Any, TypeVar, dataclass_transform

import pydantic.dataclasses
from pydantic import AfterValidator, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError
from tyro.constructors import PrimitiveConstructorSpec

from dofbench.core.budget import Budget, parse_budget
from dofbench.core.errors import InputError

Kind = TypeVar("Kind")


class _Unframed(Exception):
    """Carries an InputError through a parser that catches every ValueError."""


_parsing: ContextVar[bool] = ContextVar("parsing", default=False)


@contextmanager
def unframed_errors() -> Iterator[None]:
    """Raise the InputErrors of options that a parser builds during the block, past the parser."""
    token = _parsing.set(True)
    try:
        yield
    except _Unframed as carrier:
        raise carrier.args[0] from None
    finally:
        _parsing.reset(token)


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def options(*, kw_only: bool = False) -> Callable[[type[Kind]], type[Kind]]:
    """Make a class a frozen pydantic dataclass that raises InputError, which names the option as it is typed."""

    def decorated(kind: type[Kind]) -> type[Kind]:
        config = ConfigDict(allow_inf_nan=False, extra="forbid")
        made: Any = pydantic.dataclasses.dataclass(frozen=True, kw_only=kw_only, config=config)(kind)
        validated = made.__init__

        @functools.wraps(validated)
        def init(self: Any, *args: Any, **values: Any) -> None:
            try:
                validated(self, *args, **values)
            except ValidationError as error:
                mistake = _input_error(made, error.errors())
            except InputError as error:
                mistake = error
            else:
                return
            raise _Unframed(mistake) if _parsing.get() else mistake

        made.__init__ = init
        return made

    return decorated


def flag(name: str) -> str:
    """The option as it is typed: --test-focus for test_focus."""
    return f"--{name.replace('_', '-')}"


def given(settings: Any, name: str) -> bool:
    """Whether the option has another value than its default."""
    return bool(getattr(settings, name) != next(at.default for at in fields(settings) if at.name == name))


def spelled(values: Sequence[float]) -> str:
    """The list as one word, each number in at most six digits."""
    return ",".join(f"{value:g}" for value in values)


_EXPECTED = {
    "missing": "a value",
    "finite_number": "a finite number",
    "greater_than_equal": "at least {ge:g}",
    "greater_than": "more than {gt:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "literal_error": "one of {expected}",
}


def _input_error(kind: type, errors: Sequence[ErrorDetails]) -> InputError:
    unknown = [error["loc"][0] for error in errors if error["type"] == "unexpected_keyword_argument"]
    if unknown:
        names = ", ".join(sorted(at.name for at in fields(kind)))
        return InputError(kind.__name__, f"option {unknown[0]}", f"one of {names}")
    error = errors[0]
    context: Mapping[str, Any] = error.get("ctx", {})
    if isinstance(context.get("error"), InputError):
        return context["error"]
    expected = _EXPECTED.get(error["type"], error["msg"]).format_map(context)
    found = error["input"]
    missing = error["type"] == "missing"
    shown = "nothing" if missing else f"{found:g}" if isinstance(found, float) else repr(found)
    return InputError(flag(str(error["loc"][0])) if error["loc"] else "options", shown, expected)


def _parsed_numbers(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        return tuple(float(entry) for entry in value.split(","))
    except ValueError:
        raise PydanticCustomError("numbers", "numbers separated by commas, such as 0.2,0.5") from None


def _some(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if not values:
        raise PydanticCustomError("some", "at least one value")
    return values


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if not values or len(set(values)) < len(values):
        raise PydanticCustomError("distinct", "at least one value, and every value once")
    return values


# One word of the command line, 0.2,0.5,0.8; a tuple from there on.
_NUMBERS = PrimitiveConstructorSpec[Any](
    nargs=1,
    metavar="FLOAT,FLOAT,...",
    instance_from_str=lambda words: words[0],
    is_instance=lambda value: value is None or isinstance(value, tuple | str),
    str_from_instance=lambda values: [str(values)] if values is None else [",".join(map(repr, values))],
)
NumberList = Annotated[tuple[Kind, ...], BeforeValidator(_parsed_numbers), AfterValidator(_distinct), _NUMBERS]
# The same with values that may come again, as of keyframes.
NumberSequence = Annotated[tuple[Kind, ...], BeforeValidator(_parsed_numbers), AfterValidator(_some), _NUMBERS]


def _parsed_budget(value: Any) -> Any:
    return parse_budget(value) if isinstance(value, str) else value


# Budgets are text on the command line: the parser would make options of a dataclass's fields.
OneBudget = Annotated[
    Budget | None,
    BeforeValidator(_parsed_budget),
    PrimitiveConstructorSpec[Any](
        nargs=1,
        metavar="BUDGET",
        instance_from_str=lambda words: words[0],
        is_instance=lambda value: value is None or isinstance(value, Budget | str),
        str_from_instance=lambda value: [str(value)],
    ),
]
SeveralBudgets = Annotated[
    tuple[Annotated[Budget, BeforeValidator(_parsed_budget)], ...] | None,
    PrimitiveConstructorSpec[Any](
        nargs="*",
        metavar="BUDGET [BUDGET ...]",
        instance_from_str=tuple,
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda value: [str(value)] if value is None else list(map(str, value)),
    ),
]
