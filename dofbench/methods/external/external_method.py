"""A method that is another program: the base class for a method's folder whose presets name the commands."""

from __future__ import annotations

import hashlib
import inspect
import shlex
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import FitOutcome, Observer, Rendering, TrainingSet
from dofbench.core.errors import InputError, Status
from dofbench.core.files import read_json, write_json
from dofbench.core.lens import PhysicalLens
from dofbench.core.names import inside
from dofbench.methods.external.exchange import (
    FIGURES_FILE,
    LENSES_FILE,
    Wanted,
    read_figures,
    read_lenses,
    read_picture,
    write_training_set,
    write_wanted,
)
from dofbench.methods.external.limited_command import Limits, Taken, run_command
from dofbench.runtime.memory import machine_memory_mb
from dofbench.training.common.options import ListedOption, OptionGroups, listed_options

_MB = 1000.0  # in a GB
_SHARE = 0.9  # of the machine's memory
_KEPT = "kept.json"
_LOG = "log.txt"


@dataclass(frozen=True)
class CommandOptions:
    """The commands, and their limits."""

    train: str = ""
    """Command that trains on the folder {scene} and leaves what it needs in {model}; also {steps}, {seconds}, {seed},
    {device}, and {here}, the method's own folder. Unit: none. Source: own."""
    render: str = ""
    """Command that makes the pictures that {views}/transforms.json asks for, in {pictures}, from {model}; also {scene},
    {seed}, {device} and {here}. Unit: none. Source: own."""
    limit: float = 86400.0
    """Time after which training is ended where the budget is in steps. Unit: s. Source: own."""
    grace: float = 60.0
    """Time that training may take beyond a budget in seconds, to start and to save. Unit: s. Source: own."""
    render_limit: float = 3600.0
    """Time after which rendering is ended. Unit: s. Source: own."""
    memory_gb: float = 0.0
    """Resident memory of all processes of a command above which they are ended; 0 for nine tenths of the machine's.
    Unit: GB. Source: own."""

    def __post_init__(self) -> None:
        for name, least in (("limit", 1), ("grace", 0), ("render_limit", 1), ("memory_gb", 0)):
            if not getattr(self, name) >= least:
                raise InputError(f"option {name}", str(getattr(self, name)), f"at least {least}")

    @property
    def memory_mb(self) -> float:
        """The limit of memory, MB."""
        return self.memory_gb * _MB or _SHARE * machine_memory_mb()


@dataclass(frozen=True)
class ExternalOptions(OptionGroups):
    """All of an external method's options."""

    commands: CommandOptions = CommandOptions()


class External:
    """Trains and renders by two commands; docs/external-methods.md is the contract with them.

    A temporary folder holds the files of the commands, and is removed with the object. The model is the images, the
    lenses and the log: a loaded method shows these images and no others.
    """

    def __init__(self, options: dict[str, Any], seed: int, device: str):
        self._options = self.read_options(options).commands
        self._seed, self._device = seed, device
        self._work = tempfile.TemporaryDirectory(prefix="dofbench-external-")
        self._root = Path(self._work.name)
        self._lenses: dict[str, PhysicalLens] | None = None
        self._figures: dict[str, float] = {}
        self._files: dict[str, str] = {}  # the picture of every view that was asked for

    @classmethod
    def read_options(cls, options: Mapping[str, Any]) -> ExternalOptions:
        """All options with their defaults. Raises InputError for an unknown one, or without a command."""
        read = ExternalOptions.of(**options)
        for name in ("train", "render"):
            if not getattr(read.commands, name).strip():
                raise InputError(f"option {name}", "no command", "a command, in a preset or by --set")
        return read

    @classmethod
    def available_options(cls) -> Sequence[ListedOption]:
        return listed_options(ExternalOptions)

    def fit(self, training_set: TrainingSet, budget: Budget, observer: Observer) -> FitOutcome:
        """Write the training set, and run the command that trains. Raises InputError for a budget of processor time,
        which another program can't be held to."""
        if budget.processor:
            raise InputError("--budget", str(budget), "seconds or steps for a method in another program")
        for folder in (self._scene, self._model):
            folder.mkdir(parents=True, exist_ok=True)
        write_training_set(self._scene, training_set)
        seconds = self._options.limit if budget.seconds is None else budget.seconds + self._options.grace
        words = {
            "steps": "" if budget.steps is None else str(budget.steps),
            "seconds": "" if budget.seconds is None else f"{budget.seconds:g}",
        }

        def alive(passed: float) -> None:
            observer.stage("training in another program", int(passed), int(seconds))

        taken = self._run("train", words, seconds, alive)
        self._figures = read_figures(self._model)
        self._lenses = read_lenses(self._model, [view.name for view in training_set.views])
        steps = int(self._figures.get("steps", budget.steps or 1))
        observer.after_step(steps, 0.0)
        return FitOutcome(Status.OK, steps, peak_mb=taken.peak_mb)

    def render_ahead(self, views: Sequence[tuple[Camera, PhysicalLens | None]]) -> None:
        """Run the command that renders these views, unless all images are there."""
        keys = [_key(camera, lens) for camera, lens in views]
        if all(key in self._files for key in keys):
            return
        kinds = ["sharp" if lens is None else "lens" for _, lens in views]
        names = [f"{kind}/{index:04}.png" for index, kind in enumerate(kinds)]
        wanted = [Wanted(name, camera, lens) for name, (camera, lens) in zip(names, views, strict=True)]
        self._pictures.mkdir(parents=True, exist_ok=True)
        for one in wanted:
            (self._pictures / one.file).parent.mkdir(exist_ok=True)
        write_wanted(self._root / "views", wanted)
        self._run("render", {}, self._options.render_limit, lambda passed: None)
        for one in wanted:  # so that a missing or wrong image ends the run now, not in the middle of scoring
            read_picture(self._pictures, one.file, one.camera)
        self._files = dict(zip(keys, names, strict=True))

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Show an image that was rendered ahead. Raises ValueError for another."""
        file = self._files.get(_key(camera, lens))
        if file is None:
            raise ValueError("the program rendered the test views alone")
        return read_picture(self._pictures, file, camera)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The lenses of lenses.json."""
        return self._lenses

    def describe(self) -> dict[str, float]:
        """The figures of figures.json."""
        return dict(self._figures)

    def save(self, folder: Path | str) -> None:
        """Keep the images, the lenses, the figures and the log; not the program's own model."""
        folder = Path(folder)
        if self._pictures.is_dir():
            shutil.copytree(self._pictures, folder / "pictures", dirs_exist_ok=True)
        for source in (self._model / LENSES_FILE, self._model / FIGURES_FILE, self._log):
            if source.is_file():
                shutil.copyfile(source, folder / source.name)
        write_json(folder / _KEPT, {"files": self._files, "photographs": list(self._lenses or ())})

    def load(self, folder: Path | str) -> None:
        folder = Path(folder)
        kept = read_json(folder / _KEPT)
        self._files = {key: inside(file, folder / _KEPT) for key, file in dict(kept["files"]).items()}
        self._figures = read_figures(folder)
        self._lenses = read_lenses(folder, kept["photographs"])
        if (folder / "pictures").is_dir():
            shutil.copytree(folder / "pictures", self._pictures, dirs_exist_ok=True)

    @property
    def _scene(self) -> Path:
        return self._root / "scene"

    @property
    def _model(self) -> Path:
        return self._root / "model"

    @property
    def _pictures(self) -> Path:
        return self._root / "pictures"

    @property
    def _log(self) -> Path:
        return self._root / _LOG

    def _run(self, name: str, words: Mapping[str, str], seconds: float, alive: Callable[[float], None]) -> Taken:
        limits = Limits(seconds, self._options.memory_mb)
        return run_command(self._command(name, words), Path.cwd(), self._log, limits, alive)

    def _command(self, name: str, words: Mapping[str, str]) -> list[str]:
        """The command of that option, split as by a shell, with its words in braces filled in. Other braces stay."""
        known = {
            "scene": str(self._scene),
            "model": str(self._model),
            "views": str(self._root / "views"),
            "pictures": str(self._pictures),
            "here": str(Path(inspect.getfile(type(self))).parent),
            "seed": str(self._seed),
            "device": self._device,
            **words,
        }
        found = []
        for part in shlex.split(getattr(self._options, name)):
            for word, value in known.items():
                part = part.replace(f"{{{word}}}", value)
            found.append(part)
        return found


def _key(camera: Camera, lens: PhysicalLens | None) -> str:
    """The identity of an image."""
    numbers = [camera.width, camera.height, *camera.parameters, *camera.world_to_camera.ravel()]
    told = np.array(numbers + ([] if lens is None else [lens.aperture, lens.focus_disparity, lens.width]), np.float64)
    return hashlib.sha256(told.tobytes()).hexdigest()
