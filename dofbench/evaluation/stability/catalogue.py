"""All cases, their selection by options, and the list of known limits (limits.toml)."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from dofbench.core.errors import InputError, unknown
from dofbench.evaluation.stability.case import Case, Setting
from dofbench.evaluation.stability.stability_options import GROUPS, Stability
from dofbench.methods.cards import find_method
from dofbench.runtime.ops import ops

LIMITS = Path(__file__).with_name("limits.toml")


def catalogue(method: str | None = None) -> tuple[Case, ...]:
    """Every case, by group; training of one method, or of all that are found. Raises InputError for an unknown one."""
    found: list[Case] = []
    for group in GROUPS:
        module = import_module(f"dofbench.evaluation.stability.{group}_cases")
        found += module.cases(method) if group == "training" else module.CASES
    return tuple(found)


def chosen(settings: Stability) -> tuple[Case, ...]:
    """The selected cases, in the catalogue's order. Raises InputError for an unknown name, and if no case is left."""
    if settings.kernel is not None and settings.kernel not in ops():
        raise unknown("--kernel", settings.kernel, ops())
    if settings.kernel is not None and settings.method is not None:
        raise InputError("--kernel", "--method as well", "one of them")
    if settings.method is not None:
        find_method(settings.method)
    for group in settings.group:
        if group not in GROUPS:
            raise unknown("--group", group, GROUPS)
    every = catalogue(settings.method)
    known = {case.id for case in every}
    if strange := [name for name in settings.case if name not in known]:
        raise InputError("--case", repr(strange[0]), "a case as `dofbench stability --dry-run` lists it")
    left = tuple(
        case
        for case in every
        if settings.kernel in (None, case.subject)
        and settings.method in (None, case.subject)
        and (not settings.group or case.group in settings.group)
        and (not settings.case or case.id in settings.case)
    )
    if not left:
        raise InputError("stability", "no case that fits all of the options", "at least one")
    return left


@dataclass(frozen=True)
class Limit:
    """A case that doesn't meet its bound in some settings, on some machine. where: "backend precision", or "all"."""

    case: str
    where: tuple[str, ...]
    reason: str

    def covers(self, case: Case, setting: Setting) -> bool:
        """Whether the limit applies to this case in this setting."""
        return self.case == case.id and bool({"all", f"{setting.label} {setting.precision}"}.intersection(self.where))


def read_limits(file: Path = LIMITS) -> tuple[Limit, ...]:
    """All known limits. Raises InputError for a file that isn't a valid list."""
    try:
        entries = tomllib.loads(file.read_text(encoding="utf-8"))["limit"]
        limits = tuple(Limit(one["case"], tuple(one["where"]), " ".join(one["reason"].split())) for one in entries)
    except (OSError, tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        found = f"no list of limits ({type(error).__name__}: {error})"
        raise InputError(file, found, "[[limit]] tables with case, where and reason") from None
    named = [f"{limit.case} {place}" for limit in limits for place in limit.where]
    if twice := sorted({name for name in named if named.count(name) > 1}):
        raise InputError(file, f"{twice[0]} twice", "each once")
    if unexplained := [limit.case for limit in limits if not limit.reason]:
        raise InputError(file, f"{unexplained[0]} without a reason", "a reason")
    return limits


def limit_of(case: Case, setting: Setting, limits: Sequence[Limit]) -> Limit | None:
    """The limit that applies to a case in a setting, or None."""
    return next((limit for limit in limits if limit.covers(case, setting)), None)
