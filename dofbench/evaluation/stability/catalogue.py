"""All cases, and the selection that the options ask for."""

from __future__ import annotations

from importlib import import_module

from dofbench.core.errors import InputError, unknown
from dofbench.evaluation.stability.case import Case
from dofbench.evaluation.stability.stability_options import GROUPS, Stability
from dofbench.methods.cards import find_method
from dofbench.runtime.ops import ops


def catalogue(method: str | None = None) -> tuple[Case, ...]:
    """Every case, by group; training of one method, or of all that are found. Raises InputError for an unknown one."""
    found: list[Case] = []
    for group in GROUPS:
        module = import_module(f"dofbench.evaluation.stability.{group}_cases")
        found += module.cases(method) if group == "training" else module.CASES
    return tuple(found)


def chosen(settings: Stability) -> tuple[Case, ...]:
    """The cases that the settings ask for, in the catalogue's order.

    Raises InputError for an unknown name, and if no case is left.
    """
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
    left = [
        case
        for case in every
        if (settings.kernel is None or case.subject == settings.kernel)
        and (settings.method is None or case.subject == settings.method)
        and (not settings.group or case.group in settings.group)
        and (not settings.case or case.id in settings.case)
    ]
    if not left:
        raise InputError("stability", "no case that fits all of the options", "at least one")
    return tuple(left)
