"""What a result doesn't prove, as signs beside it: it is of a development scene, or wasn't made by a frozen preset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dofbench.core.evidence import PHOTOGRAPHERS, ROLES, Photographer, Role
from dofbench.evaluation.results.collecting import Entry
from dofbench.methods.frozen_presets import State, state_of

DEVELOPMENT, NOT_FROZEN, CHANGED, OTHER_BUDGET = "†", "‡", "§", "¶"
# Sign -> the line below every table that has it, in this order
NOTES = {
    DEVELOPMENT: (
        f"{DEVELOPMENT} Of a development scene, on which presets were chosen: no evidence of quality on other scenes."
    ),
    NOT_FROZEN: (
        f"{NOT_FROZEN} Preset not frozen: nothing shows that it was chosen before it was run on this report scene."
    ),
    CHANGED: f"{CHANGED} Not the frozen preset: options or their defaults differ from those that were frozen.",
    OTHER_BUDGET: f"{OTHER_BUDGET} The frozen preset under another budget than its own.",
}
_SIGN_OF_STATE: dict[State, str] = {
    "frozen": "",
    "other budget": OTHER_BUDGET,
    "not frozen": NOT_FROZEN,
    "changed": CHANGED,
}


def role_of(members: Iterable[Entry]) -> Role | None:
    """The role of the scene of a board, which a run that died doesn't state; None where no result does."""
    return next((entry.result.role for entry in members if entry.result and entry.result.role), None)


def photographer_of(members: Iterable[Entry]) -> Photographer | None:
    """What took the photographs of a board; None where no result states it."""
    return next((entry.result.photographer for entry in members if entry.result and entry.result.photographer), None)


def frozen_state(entry: Entry) -> State:
    """Whether the run was made by a frozen preset."""
    spec = entry.spec
    return state_of(spec.method, spec.preset, entry.choices, spec.budget)


def signs(role: Role | None, entries: Sequence[Entry]) -> str:
    """The signs of a row with these runs, on a scene of this role; a preset counts on report scenes alone."""
    if role == "development":
        return DEVELOPMENT
    if role != "report":
        return ""
    return united(_SIGN_OF_STATE[frozen_state(entry)] for entry in entries)


def united(several: Iterable[str]) -> str:
    """All signs that any of these texts has, each once, in the order of `NOTES`."""
    found = "".join(several)
    return "".join(sign for sign in NOTES if sign in found)


def notes(several: Iterable[str]) -> tuple[str, ...]:
    """The lines below a table whose rows have these signs."""
    return tuple(NOTES[sign] for sign in united(several))


def place(role: Role | None, photographer: Photographer | None) -> tuple[int, int]:
    """Sort key of a board: report scenes first, and photographs through a lens before those by a formula."""
    return ROLES.index(role), PHOTOGRAPHERS.index(photographer)
