"""Making cases: a single one, or one for every value of an option."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

from dofbench.evaluation.stability.case import Case, Found, Setting


@dataclass(frozen=True)
class Subject:
    """Makes the cases of one group that test one subject in the same settings. The fields are those of `Case`."""

    group: str
    subject: str
    settings: tuple[Setting, ...]

    def case(self, name: str, holds: str, bound: str, measure: Callable[..., Found], /, **options: Any) -> Case:
        """One case. Its measure is called with the setting and these options."""
        run = partial(measure, **options) if options else measure
        return Case(self.group, name, self.subject, holds, bound, self.settings, run)

    def each(
        self, name: str, holds: str, bound: str, measure: Callable[..., Found], /, **options: Collection[Any]
    ) -> tuple[Case, ...]:
        """A case for every combination of the options' values, the last option's varying fastest.

        options: the values of each, or values by label. name, holds: formatted with the case's own values, and with
        its labels: "{gamma:g}" is the option gamma, "{gamma_label}" is what its value is called.
        """
        made = []
        for chosen in product(*(_labelled(values) for values in options.values())):
            one = {option: value for option, (_, value) in zip(options, chosen, strict=True)}
            labels = {f"{option}_label": label for option, (label, _) in zip(options, chosen, strict=True)}
            given = {**one, **labels}
            made.append(self.case(name.format(**given), holds.format(**given), bound, measure, **one))
        return tuple(made)


def _labelled(values: Collection[Any]) -> tuple[tuple[str, Any], ...]:
    return tuple(values.items()) if isinstance(values, Mapping) else tuple((str(value), value) for value in values)
