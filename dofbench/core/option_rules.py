"""What an option's value must be, and beside which others it may stand: rules, declared at the option's field.

    width: int | None = option(None, at_least(8))
    test_focus: float | None = option(None, OnlyWith("assign", "held-out"))

`check` applies them to a settings object; each mistake is an InputError that names the options as they are typed. An
option that has its default was not given, and breaks no rule about others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import Field, dataclass, field, fields
from typing import Any, Protocol

from dofbench.core.errors import InputError
from dofbench.core.number_lists import spelled

_RULES = "rules"


class Rule(Protocol):
    """Something that holds of one option of a settings object."""

    def check(self, options: Any, at: Field[Any]) -> None:
        """Raise InputError unless it holds of `options`' field `at`."""


def option(default: Any, *rules: Rule, **facts: Any) -> Any:
    """A dataclass field with its rules. facts: what else is known of the option, by name; in the field's metadata."""
    return field(default=default, metadata={_RULES: rules, **facts})


def check(options: Any) -> None:
    """Raise InputError for the first rule, in the order of the fields, that a settings object breaks."""
    for at in fields(options):
        for rule in at.metadata.get(_RULES, ()):
            rule.check(options, at)


def flag(name: str) -> str:
    """The option as it is typed: --test-focus for test_focus."""
    return f"--{name.replace('_', '-')}"


def given(options: Any, at: Field[Any]) -> bool:
    """Whether the option has another value than its default."""
    return getattr(options, at.name) != at.default


@dataclass(frozen=True)
class Is:
    """holds: of a value, unless that is None. expected: what it should have been, in words."""

    holds: Callable[[Any], bool]
    expected: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        value = getattr(options, at.name)
        if value is not None and not self.holds(value):
            raise InputError(flag(at.name), str(value), self.expected)


def at_least(lowest: int) -> Is:
    """No number below `lowest`."""
    return Is(lambda value: value >= lowest, f"at least {lowest}")


POSITIVE = Is(lambda value: math.isfinite(value) and value > 0, "a positive number")
NOT_NEGATIVE = Is(lambda value: math.isfinite(value) and value >= 0, "0 or a positive number")
DEGREES = Is(math.isfinite, "degrees")


@dataclass(frozen=True)
class EachFrom:
    """Of a list of numbers: each from `low` to `high`, and none twice."""

    low: float
    high: float

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        values = getattr(options, at.name) or ()
        for value in values:
            if not self.low <= value <= self.high:  # also catches NaN
                raise InputError(flag(at.name), f"{value:g}", f"numbers from {self.low:g} to {self.high:g}")
        if len(set(values)) < len(values):
            raise InputError(flag(at.name), spelled(values), "every value once")


@dataclass(frozen=True)
class OnlyWith:
    """Means something only where the option `other` has `value`."""

    other: str
    value: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        if given(options, at) and (found := getattr(options, self.other)) != self.value:
            needed = f"{flag(self.other)} {self.value}"
            raise InputError(flag(at.name), f"{flag(self.other)} {found}", f"{needed}, the only one that uses it")


@dataclass(frozen=True)
class NeededWith:
    """Must be given where the option `other` has `value`. expected: what it would say."""

    other: str
    value: str
    expected: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        if not given(options, at) and getattr(options, self.other) == self.value:
            raise InputError(f"{flag(self.other)} {self.value}", f"no {flag(at.name)}", self.expected)


@dataclass(frozen=True)
class Needs:
    """Means nothing without the option `other`. expected: why, or what both are for."""

    other: str
    expected: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        if given(options, at) and getattr(options, self.other) is None:
            raise InputError(flag(at.name), f"no {flag(self.other)}", self.expected)


@dataclass(frozen=True)
class NotBeside:
    """May not be given together with the option `other`, whose default is None. expected: why."""

    other: str
    expected: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        if given(options, at) and (found := getattr(options, self.other)) is not None:
            raise InputError(flag(at.name), f"{flag(self.other)} {found} too", self.expected)


@dataclass(frozen=True)
class DefaultWith:
    """Keeps its default where the option `other` has `value`. expected: what it is then; unless: of the settings."""

    other: str
    value: str
    expected: str
    unless: Callable[[Any], bool] = lambda options: False

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        if given(options, at) and getattr(options, self.other) == self.value and not self.unless(options):
            found = getattr(options, at.name)
            shown = f"{found:g}" if isinstance(found, float) else found
            raise InputError(f"{flag(self.other)} {self.value}", f"{flag(at.name)} {shown}", self.expected)


@dataclass(frozen=True)
class AtMostWith:
    """Of a list: no more than `most` values where the option `other` has `value`. expected: what they are."""

    other: str
    value: str
    most: int
    expected: str

    def check(self, options: Any, at: Field[Any]) -> None:
        """See `Rule`."""
        values = getattr(options, at.name)
        if getattr(options, self.other) == self.value and len(values) > self.most:
            subject = f"{flag(at.name)} with {flag(self.other)} {self.value}"
            raise InputError(subject, f"{len(values)} values", self.expected)
