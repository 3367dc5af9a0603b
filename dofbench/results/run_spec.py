"""What a call says of its runs, declared once for one run, a matrix of runs and tables of runs."""

from __future__ import annotations

import json
import shlex
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.dataset.inputs import Inputs


@dataclass(frozen=True, kw_only=True)
class CallOptions:
    """What every call that makes runs says."""

    set: tuple[str, ...] = ()
    """Options that replace the preset's, as key=value with a TOML value: --set sh_degree=1 lens_lr=1e-3."""
    device: str = "auto"
    """cpu, cuda, or auto: cuda where there is one."""
    dry_run: bool = False
    """Print what would be done and left out, which runs are finished, and an estimate of the time; stop there."""


@dataclass(frozen=True, kw_only=True)
class SeveralOptions:
    """What a call that makes several runs says of how it makes them."""

    jobs: int = 1
    """Runs at the same time, each in a process of its own with its share of the threads."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError("--jobs", str(self.jobs), "at least 1")


@dataclass(frozen=True, kw_only=True)
class WhichMethods:
    """Which method, or which ones."""

    method: str
    """Ids of methods, comma-separated: folders in methods/ or in a folder that DOFBENCH_METHODS lists."""
    preset: str | None = None
    """Presets of the methods' method.toml, comma-separated. Default: the one that the file calls default_preset, or
    builtin_preset on the built-in dataset."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(CallOptions, WhichMethods):
    """What one run and a matrix of runs have in common; of one run `method` and `preset` are a single one."""

    seed: int = 0
    """Seed of everything random in the method; with --seeds the first of them."""
    inputs: Inputs = "shallow"
    """Train on the shallow photographs, or on the sharp originals: that is a protocol of its own."""
    force_all: bool = False
    """Do also what the plan would leave out because the dataset doesn't need it."""
    rerun: bool = False
    """Run again although a finished result of the same key is there."""
    out: Path = Path("results")
    """Folder of results; a run writes to OUT/DATASET/METHOD-PRESET-seedN-KEY/, alone or in a matrix."""


@dataclass(frozen=True, kw_only=True)
class Run(RunOptions):
    """One run (`dofbench.running.run_options` has the call, which may name many).

    data: the dataset's folder, None for the built-in dataset. budget: None for the preset's.
    """

    data: Path | None = None
    budget: Budget | None = None

    def command(self) -> str:
        """The command line that says the same, with what is not the default; paths as they were given."""
        return command_line("run", self, without=("rerun", "dry_run"))


def command_line(command: str, options: Any, *, without: Collection[str] = ()) -> str:
    """The call of `dofbench` that says the same as `options`, a dataclass, but for what is the default or `without`."""
    words = ["dofbench", command]
    for field in fields(options):
        value = getattr(options, field.name)
        if value == field.default or field.name in without:
            continue
        words.append("--" + field.name.replace("_", "-"))
        if isinstance(value, tuple):
            words.extend(map(str, value))
        elif value is not True:
            words.append(str(value))
    return shlex.join(words)


def option_words(options: Mapping[str, Any]) -> list[str]:
    """Each option as "key=value", the way that `--set` takes it and tables show it."""
    return [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in options.items()]


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
