"""Presets that were frozen: what may be run on report scenes, and whether a result was made by it.

A preset is frozen by its content, not by its name: the file `frozen.toml` beside the method's card holds a digest of
all that the preset chooses, and the commit at which it was frozen, for the reader. Every result has the digest of what
its run chose, so that a result by another preset or by changed options or defaults is told from one by the frozen
preset, and one that differs from it in nothing but its budget from both.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dofbench.core.budget import Budget, parse_budget
from dofbench.core.contracts import ListsOptions
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, sha256_text, write_text
from dofbench.core.readable import read_toml
from dofbench.methods.cards import MethodEntry, find_method, kept, method_files, preset_budget

FROZEN_FILE = "frozen.toml"
_HEADER = """\
# Frozen presets: what may be run on report scenes. `dofbench methods {id} --freeze PRESET` writes an entry:
# the commit at which the preset was frozen, and a digest of all that it chooses
# (dofbench/methods/frozen_presets.py).
"""
_NOTHING = "# No preset is frozen yet.\n"

# frozen: made by a frozen preset. other budget: by a frozen preset, but the call gave the budget. changed: by something
# else, although a preset of that name is frozen. not frozen: no preset of that name is.
State = Literal["frozen", "other budget", "changed", "not frozen"]


# Options added after presets had been frozen, each with its neutral value: with it a run is what it was before
# there was the option, so it isn't part of what was chosen.
_NEUTRAL: dict[str, Any] = {
    "lens_focus_from": "option",
    "lens_free_until": 0.0,
    "lens_measured_at": 1.0,
    "lens_frozen_until": 0.0,
    "lens_within": 2.0,
    "patience": 0.0,
    "prune_near": 0.0,
    "near_share": 0.0,
    "start_behind": 0.0,
    "lens_trials_from": 0.0,
    "restart_at": 0.0,
    "depth_variation": 0.0,
    "colour_variation": 0.0,
    "mixing": "together",
    "mixing_width": 16,
    "focus_network": False,
    "focus_network_lr": 1e-3,
}


class FrozenPreset(BaseModel):
    """commit: at which the preset was frozen. digest: `choices_digest` of it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    commit: str = Field(pattern=r"^[0-9a-f]{40}$")
    digest: str = Field(pattern=r"^[0-9a-f]{64}$")


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    presets: dict[str, FrozenPreset] = {}


def choices_digest(entry: MethodEntry, options: dict[str, Any], budget: Budget, force_all: bool) -> str:
    """sha256 of all that decides a run but dataset, seed, device and code.

    options: the preset's with the call's changes; the method's defaults are added, where its class lists them, but for
    neutral values of newer options (`_NEUTRAL`). The stages of its card are part of it, since they say which options a
    plan changes.
    """
    kind = entry.method_class()
    known = kind.available_options() if isinstance(kind, ListsOptions) else ()
    every = {**{option.name: option.default for option in known}, **options}
    chosen = {
        "options": {name: value for name, value in every.items() if (name, value) not in _NEUTRAL.items()},
        "budget": str(budget),
        "force_all": force_all,
        "stages": {name: stage.model_dump() for name, stage in sorted(entry.card.stages.items())},
        "trials": entry.card.trials,
    }
    return sha256_text(canonical_json(chosen))


def preset_digest(entry: MethodEntry, preset: str) -> str:
    """`choices_digest` of a preset as the method's card has it. Raises InputError for an unknown preset."""
    name, options, budget = entry.preset(preset)
    return choices_digest(entry, options, preset_budget(entry, name, options, budget), force_all=False)


def frozen_presets(folder: Path) -> dict[str, FrozenPreset]:
    """Preset -> how it was frozen, of the method in `folder`; empty without a file. Raises InputError, one line, for a
    damaged file."""
    file = folder / FROZEN_FILE
    if not file.is_file():
        return {}
    try:
        return _File.model_validate(read_toml(file, "a TOML file")).presets
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise InputError(file, found, "[presets.NAME] with commit and digest") from None


def state_of(method: str, preset: str, choices: str | None, budget: str) -> State:
    """Whether a result was made by a frozen preset. choices: the result's digest, None where it has none. budget: the
    run's, as text.

    That only the budget differs shows where the preset as it is now is what was frozen, and gives the result's digest
    with the result's budget. Raises InputError for a damaged card or file.
    """
    return standing(method, preset).state(choices, budget)


def standing(method: str, preset: str) -> PresetStanding:
    """Whether a preset is frozen, to ask of many results (`state_of`). Raises InputError for a damaged file."""
    return kept(("standing", method, preset), lambda: _standing(method, preset))


def _standing(method: str, preset: str) -> PresetStanding:
    files = method_files()
    found = frozen_presets(files[method].parent).get(preset) if method in files else None
    return PresetStanding(method, preset, None if found is None else found.digest)


@dataclass(frozen=True)
class PresetStanding:
    """A preset, and the digest by which it is frozen; None if it isn't. The method is read where a result asks."""

    method: str
    preset: str
    digest: str | None

    def state(self, choices: str | None, budget: str) -> State:
        """As `state_of`."""
        if self.digest is None:
            return "not frozen"
        if self.digest == choices:
            return "frozen"
        if not self._as_frozen:
            return "changed"
        if budget not in self._by_budget:
            entry = find_method(self.method)
            _, options, _ = entry.preset(self.preset)
            self._by_budget[budget] = choices_digest(entry, options, parse_budget(budget), force_all=False)
        return "other budget" if choices == self._by_budget[budget] else "changed"

    @cached_property
    def _as_frozen(self) -> bool:
        """Whether the preset as it is now is what was frozen."""
        entry = find_method(self.method)
        return self.preset in entry.card.presets and preset_digest(entry, self.preset) == self.digest

    @cached_property
    def _by_budget(self) -> dict[str, str]:
        """Budget -> digest of a run of the preset as it is now."""
        return {}


def freeze(method: str, preset: str) -> FrozenPreset:
    """Write the preset into the method's frozen.toml, with the present commit; returns the entry.

    A preset that is frozen as it is stays so. Raises InputError for an unknown method or preset, outside a checkout,
    with uncommitted changes, and for a preset that is frozen with other content: a changed preset takes a new name.
    """
    entry = find_method(method)
    digest = preset_digest(entry, preset)
    presets = frozen_presets(entry.folder)
    subject = f"preset {preset} of {entry.id}"
    if (before := presets.get(preset)) is not None:
        if before.digest != digest:
            raise InputError(subject, f"other options than at {before.commit[:12]}, when it was frozen", "another name")
        return before
    made = FrozenPreset(commit=_commit(entry.folder, subject), digest=digest)
    write_text(entry.folder / FROZEN_FILE, frozen_text(entry.id, presets | {preset: made}))
    return made


def _commit(folder: Path, subject: str) -> str:
    """The commit of the checkout that a method's card belongs to; nothing in it but frozen presets may have changed."""
    expected = "a commit that says what is frozen"

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "method.toml")  # not a checkout that only happens to lie around the folder
        changed = git("status", "--porcelain", "--", ":/", f":(top,exclude,glob)**/{FROZEN_FILE}")
        commit = git("rev-parse", "HEAD")
    except (OSError, subprocess.CalledProcessError):
        raise InputError(subject, "no commit, as its method.toml is in no checkout", expected) from None
    if changed:
        raise InputError(subject, f"uncommitted changes ({changed.splitlines()[0].split()[-1]})", expected)
    return commit


def frozen_text(method: str, presets: dict[str, FrozenPreset]) -> str:
    """The content of a frozen.toml."""
    parts = [
        f'[presets.{name}]\ncommit = "{one.commit}"\ndigest = "{one.digest}"\n' for name, one in sorted(presets.items())
    ]
    return "\n".join([_HEADER.format(id=method), *parts]) if parts else _HEADER.format(id=method) + _NOTHING
