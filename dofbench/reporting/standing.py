"""What a result doesn't prove, as signs in tables: it is of a tuning scene, or its preset wasn't fixed before."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dofbench.core.evidence import PHOTOGRAPHERS, ROLES, Photographer, Role
from dofbench.evaluation.results.collecting import Entry
from dofbench.methods.frozen_presets import State, state_of

DEVELOPMENT, NOT_FROZEN, CHANGED, OTHER_BUDGET = "†", "‡", "§", "¶"
# Sign -> its note below every table that has it, in this order
NOTES = {
    DEVELOPMENT: f"{DEVELOPMENT} Tuning scene: presets were chosen on it, so it shows nothing about other scenes.",
    NOT_FROZEN: f"{NOT_FROZEN} Preset not fixed before this test scene was run.",
    CHANGED: f"{CHANGED} Not the fixed preset: options or their defaults differ.",
    OTHER_BUDGET: f"{OTHER_BUDGET} Fixed preset under another budget than its own.",
}
_SIGN_OF_STATE: dict[State, str] = {
    "frozen": "",
    "other budget": OTHER_BUDGET,
    "not frozen": NOT_FROZEN,
    "changed": CHANGED,
}


def role_of(members: Iterable[Entry]) -> Role | None:
    """The role of a board's scene; None where no result states it (a run that died doesn't)."""
    return next((entry.result.role for entry in members if entry.result and entry.result.role), None)


def photographer_of(members: Iterable[Entry]) -> Photographer | None:
    """How a board's input images were made; None where no result states it."""
    return next((entry.result.photographer for entry in members if entry.result and entry.result.photographer), None)


def frozen_state(entry: Entry) -> State:
    """Whether the run was made with a fixed preset."""
    return state_of(entry.spec.method, entry.spec.preset, entry.choices, entry.spec.budget)


def signs(role: Role | None, entries: Sequence[Entry]) -> str:
    """The signs of a row with these runs on a scene of this role; the preset counts on test scenes alone."""
    if role == "development":
        return DEVELOPMENT
    return united(_SIGN_OF_STATE[frozen_state(entry)] for entry in entries) if role == "report" else ""


def united(several: Iterable[str]) -> str:
    """All signs of these texts, each once, in the order of `NOTES`."""
    found = "".join(several)
    return "".join(sign for sign in NOTES if sign in found)


def notes(several: Iterable[str]) -> tuple[str, ...]:
    """The notes below a table whose rows have these signs."""
    return tuple(NOTES[sign] for sign in united(several))


def place(role: Role | None, photographer: Photographer | None) -> tuple[int, int]:
    """Sort key of a board: test scenes first, and ray-traced or real defocus before synthetic defocus."""
    return ROLES.index(role), PHOTOGRAPHERS.index(photographer)
