"""Options shared by a single run, a matrix of runs and ablation tables."""

from __future__ import annotations

import json
import shlex
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import OneBudget, flag, options
from dofbench.datasets.format.inputs import Inputs
from dofbench.runtime.executors import WhereOptions


@options(kw_only=True)
class CallOptions:
    """Options of every command that makes runs."""

    set: tuple[str, ...] = ()
    """Hyperparameters that replace the preset's, key=value in TOML: --set sh_degree=1 lens_lr=1e-3."""
    device: str = "auto"
    """cpu, cuda, or auto: cuda if the machine has such a device and the method runs on it, else cpu."""
    dry_run: bool = False
    """Only print the plan: stages, scores, cached results and the estimated time."""
    verbose: bool = False
    """Print the whole plan before training; without it, at most five lines."""


@options(kw_only=True)
class SeveralOptions(WhereOptions):
    """Options of commands that make several runs."""

    jobs: Annotated[int, Field(ge=1)] | None = None
    """Runs at the same time, each in a process of its own with its share of the threads. Default: the number of GPUs
    where runs are on any, else 1."""


@options(kw_only=True)
class WhichMethods:
    """Options that choose the methods."""

    method: str
    """Ids of methods, comma-separated: folders in methods/ or in a folder that DOFBENCH_METHODS lists."""
    preset: str | None = None
    """Presets of the methods' method.toml, comma-separated. Default: the file's default_preset, or its builtin_preset
    on the built-in dataset, or its gpu_preset on a GPU."""


@options(kw_only=True)
class RunOptions(CallOptions, WhichMethods):
    """Options that a single run and a matrix of runs have in common; in a single run `method` and `preset` name one
    each."""

    seed: int = 0
    """Seed of everything random in the method; with --seeds, the first seed."""
    inputs: Inputs = "shallow"
    """Train on images with a shallow depth of field, or on the all-in-focus ones, under a protocol of their own."""
    held_out: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of every training view's pixels, in tiles of 16 px, that no method receives; the run is scored on them."""
    force_all: bool = False
    """Run every stage, also those that the dataset doesn't need."""
    log: Literal["tensorboard"] | None = None
    """Write the learning curve for TensorBoard to the run's folder, with a test view at each point. Needs the extra
    tensorboard."""
    watch: bool = False
    """Save the scene every 10 s while it trains, so that `dofbench view RUN` shows it growing."""
    rerun: bool = False
    """Train again even where a cached result of the same key exists."""
    out: Path = Path("results")
    """Folder of results; a run writes to OUT/DATASET/METHOD-PRESET-seedN-KEY/, alone or in a matrix."""


@options(kw_only=True)
class RunSpec(RunOptions):
    """One run. (The command's options, which may name many runs, are in `dofbench.running.run_options`.)

    data: the dataset's folder, None for the built-in dataset. budget: None for the preset's.
    """

    data: Path | None = None
    budget: OneBudget = None

    def command(self) -> str:
        """The command line of this run, with the options that differ from their defaults; paths as the user gave
        them. A log and snapshots change no result."""
        return command_line("run", self, without=("log", "watch", "rerun", "dry_run", "verbose"))


def command_line(command: str, options: Any, *, without: Collection[str] = ()) -> str:
    """The command line of `dofbench` for `options`, a dataclass; defaults and the fields in `without` are omitted."""
    words = ["dofbench", command]
    for field in fields(options):
        value = getattr(options, field.name)
        if value == field.default or field.name in without:
            continue
        words.append(flag(field.name))
        if isinstance(value, tuple):
            words.extend(map(str, value))
        elif value is not True:
            words.append(str(value))
    return shlex.join(words)


def option_words(options: Mapping[str, Any]) -> list[str]:
    """Each option as "key=value", the form of `--set` and of tables."""
    return [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in options.items()]


def parse_overrides(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Read key=value pairs. A value that isn't TOML (a bare word) is a string.

    Numbers are parsed instead of kept as text, so that 1e-3 and 0.001 are the same run.
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
    # "1\nother = 2" would be valid TOML too, but isn't a single value.
    return document["value"] if len(document) == 1 else text
