"""How the command line reads budgets: text at the door, `Budget` from there on."""

from __future__ import annotations

from typing import Annotated, Any

from tyro.constructors import PrimitiveConstructorSpec

from dofbench.core.budget import Budget, parse_budget

# The parser would make an option with parts of a dataclass, and lose the message of a wrong one in a union.
OneBudget = Annotated[
    Budget | None,
    PrimitiveConstructorSpec[Any](
        nargs=1,
        metavar="BUDGET",
        instance_from_str=lambda words: parse_budget(words[0]),
        is_instance=lambda value: value is None or isinstance(value, Budget),
        str_from_instance=lambda value: [str(value)],
    ),
]
SeveralBudgets = Annotated[
    tuple[Budget, ...] | None,
    PrimitiveConstructorSpec[Any](
        nargs="*",
        metavar="BUDGET [BUDGET ...]",
        instance_from_str=lambda words: tuple(map(parse_budget, words)),
        is_instance=lambda value: value is None or isinstance(value, tuple),
        str_from_instance=lambda value: [str(value)] if value is None else list(map(str, value)),
    ),
]
