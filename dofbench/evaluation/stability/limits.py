"""The list of known limits (limits.toml): cases whose bound isn't met in some settings, each with the reason."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.evaluation.stability.case import Case, Setting

FILE = Path(__file__).with_name("limits.toml")


@dataclass(frozen=True)
class Limit:
    """A case that doesn't meet its bound in some settings, on some machine. where: "backend precision", or "all"."""

    case: str
    where: tuple[str, ...]
    reason: str

    def covers(self, case: Case, setting: Setting) -> bool:
        """Whether the limit applies to this case in this setting."""
        place = f"{setting.label} {setting.precision}"
        return self.case == case.id and ("all" in self.where or place in self.where)


def read_limits(file: Path = FILE) -> tuple[Limit, ...]:
    """All known limits. Raises InputError for a file that isn't such a list."""
    try:
        entries = tomllib.loads(file.read_text(encoding="utf-8"))["limit"]
        limits = tuple(
            Limit(entry["case"], tuple(entry["where"]), " ".join(entry["reason"].split())) for entry in entries
        )
    except (OSError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise InputError(
            file, f"no list of limits ({type(error).__name__}: {error})", "[[limit]] tables with case, where and reason"
        ) from None
    named = [(limit.case, place) for limit in limits for place in limit.where]
    if twice := sorted({f"{case} {place}" for case, place in named if named.count((case, place)) > 1}):
        raise InputError(file, f"{twice[0]} twice", "each once")
    if unexplained := [limit.case for limit in limits if not limit.reason]:
        raise InputError(file, f"{unexplained[0]} without a reason", "a reason")
    return limits


def limit_of(case: Case, setting: Setting, limits: Sequence[Limit]) -> Limit | None:
    """The limit that applies to a case in a setting, or None."""
    return next((limit for limit in limits if limit.covers(case, setting)), None)
