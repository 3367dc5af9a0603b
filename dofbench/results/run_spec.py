"""What one run is told, and how its small languages (budget, key=value) are read."""

from __future__ import annotations

import shlex
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from dofbench.core.contracts import Budget
from dofbench.core.errors import InputError
from dofbench.dataset.inputs import Inputs


@dataclass(frozen=True)
class Run:
    """One run, as `dofbench run` makes it (`dofbench.running.run_options` has the call, which may name many)."""

    method: str
    """Id of the method: a folder in methods/ or in a folder that DOFBENCH_METHODS lists."""
    data: Path | None = None
    """Dataset folder. Default: the built-in dataset, made first if it isn't there."""
    preset: str | None = None
    """A preset of the method's method.toml. Default: the one that the file calls default_preset, or builtin_preset on
    the built-in dataset."""
    set: tuple[str, ...] = ()
    """Options that replace the preset's, as key=value with a TOML value: --set sh_degree=1 lens_lr=1e-3."""
    budget: str | None = None
    """When training stops: 300s, 5min, 7000it, or both (300s,7000it), whichever comes first. Default: the preset's."""
    seed: int = 0
    """Seed of everything random in the method."""
    device: str = "auto"
    """cpu, cuda, or auto: cuda where there is one."""
    out: Path = Path("results")
    """Folder of results; the run writes to OUT/DATASET/METHOD-PRESET-seedN-KEY/."""
    inputs: Inputs = "shallow"
    """Train on the shallow photographs, or on the sharp originals: that is a protocol of its own."""
    dry_run: bool = False
    """Print what would be done and left out, and stop there."""
    force_all: bool = False
    """Do also what the plan would leave out because the dataset doesn't need it."""
    rerun: bool = False
    """Run again although a finished result of the same key is there."""

    def command(self) -> str:
        """The command line that says the same, with what is not the default; paths as they were given."""
        words = ["dofbench", "run"]
        for field in fields(self):
            value = getattr(self, field.name)
            if value == field.default or field.name in ("rerun", "dry_run"):
                continue
            words.append("--" + field.name.replace("_", "-"))
            if isinstance(value, tuple):
                words.extend(value)
            elif value is not True:
                words.append(str(value))
        return shlex.join(words)


def parse_budget(text: str) -> Budget:
    """Read "300s", "5min", "7000it" or "300s,7000it". Raises InputError for anything else."""
    steps: int | None = None
    seconds: float | None = None
    expected = "seconds (300s), minutes (5min), steps (7000it) or time and steps (300s,7000it), each above zero"
    for part in text.replace(" ", "").split(","):
        try:
            if part.endswith("it") and steps is None:
                steps = int(part[:-2])
                good = steps > 0
            elif part.endswith(("s", "min")) and seconds is None:
                seconds = 60 * float(part[:-3]) if part.endswith("min") else float(part[:-1])
                good = 0 < seconds < float("inf")
            else:
                good = False
        except ValueError:
            good = False
        if not good:
            raise InputError("budget", repr(text), expected)
    return Budget(steps=steps, seconds=seconds)


def format_budget(budget: Budget) -> str:
    """The shortest text that `parse_budget` reads back as `budget`."""
    parts = []
    if budget.seconds is not None:
        parts.append(f"{budget.seconds:g}s")
    if budget.steps is not None:
        parts.append(f"{budget.steps}it")
    return ",".join(parts)


def parse_overrides(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Read key=value pairs. A value that isn't TOML (a bare word) is a string.

    Numbers are read here and not kept as text, so that 1e-3 and 0.001 are the same run.
    Raises InputError for a pair without "=", an empty key, or a key given twice.
    """
    overrides: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        key = key.strip()
        if not equals or not key:
            raise InputError("--set", repr(pair), "key=value")
        if key in overrides:
            raise InputError("--set", f"{key} twice", "each option once")
        overrides[key] = _value(text.strip())
    return overrides


def _value(text: str) -> Any:
    try:
        document = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    # "1\nother = 2" would be TOML too, but no value.
    return document["value"] if len(document) == 1 else text
