"""A method folder and a dataset that cost nothing, for the tests of the harness and of the reports."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError, one_line
from dofbench.core.exif import Exif
from dofbench.core.files import sha256_file
from dofbench.core.images import from_8bit, to_8bit
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.core.processes import Job, Outcome
from dofbench.metrics import METRICS
from dofbench.reporting import truth_images as truth_module
from dofbench.results.run_spec import Run
from dofbench.running import check as check_module
from dofbench.running import one_run as run_module
from dofbench.running import planned_runs as planned_module
from dofbench.running import prepare as prepare_module
from dofbench.running import rescore as score_module
from dofbench.running.facts import Facts
from dofbench.running.one_run import RunEnd

WIDTH, HEIGHT = 64, 48


@dataclass(frozen=True, eq=False)
class FakeView:
    """As `dofbench.dataset.dataset.DatasetView`."""

    name: str
    split: str
    camera: Camera
    lens: Lens | None
    physical_lens: PhysicalLens | None
    max_coc_px: float | None
    has_all_in_focus: bool = True
    has_depth: bool = True
    exif: Exif | None = None


class FakeDataset:
    """As `dofbench.dataset.dataset.Dataset`; its folder holds a dataset.json with these few choices.

    The image of a view is smooth noise; its shallow photograph is the sharp one, darkened by the aperture, which only
    this class knows where the view's lens is unknown.
    """

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        if not (self.folder / "dataset.json").is_file():
            raise InputError(folder, "no dataset.json", "a dataset folder")
        choices = json.loads((self.folder / "dataset.json").read_text())
        self.name, self.scene = choices["name"], choices["name"].split("_")[0]
        self.checksum = sha256_file(self.folder / "dataset.json")
        self.has_points = choices["points"]
        self.has_exact_depth = choices["exact"]
        self._unknown, self._blurred, self._flat = (set(choices[key]) for key in ("unknown", "blurred", "flat"))
        self.disparity_range = DisparityRange(0.1, 0.6)
        self._seed = choices["seed"]
        self.views = tuple(
            self._view(f"v{index}", "test" if index < choices["test"] else "train", choices["coc"], index)
            for index in range(choices["test"] + choices["train"])
        )
        known = any(view.lens is not None for view in self.views)
        self.assign = choices["assign"] if known or not self.views else "unknown"

    load = classmethod(lambda cls, folder: cls(folder))

    def _view(self, name: str, split: str, coc: float, index: int) -> FakeView:
        pose = np.eye(4)
        pose[0, 3] = index
        camera = Camera(WIDTH, HEIGHT, 200.0, 200.0, WIDTH / 2, HEIGHT / 2, pose)
        lens = self._lens(index)
        known = name not in self._unknown
        return FakeView(
            name,
            split,
            camera,
            lens if known else None,
            lens.physical(self.disparity_range, WIDTH) if known else None,
            coc if known else None,
            name not in self._blurred,
            name not in self._flat,
        )

    @staticmethod
    def _lens(index: int) -> Lens:
        return Lens(aperture=(0.5, 1.0)[index % 2], focus=(0.2, 0.5, 0.8)[index % 3])

    def view(self, name: str) -> FakeView:
        return next(view for view in self.views if view.name == name)

    def test_views(self) -> tuple[FakeView, ...]:
        return tuple(view for view in self.views if view.split == "test")

    def all_in_focus(self, view: FakeView) -> np.ndarray | None:
        return sharp_image(self._seed, view.camera) if view.has_all_in_focus else None

    def image(self, view: FakeView) -> np.ndarray:
        aperture = self._lens(int(view.name[1:])).aperture
        return from_8bit(to_8bit(sharp_image(self._seed, view.camera) * (1 - 0.1 * aperture)))

    def require_intact(self, view: FakeView, part: str) -> None:
        """Its pictures are computed: none can have changed."""

    def depth(self, view: FakeView) -> np.ndarray | None:
        if not view.has_depth:
            return None
        return np.linspace(2.0, 9.0, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)

    def training_set(self, inputs: str = "shallow") -> TrainingSet:
        read = self.image if inputs == "shallow" else self.all_in_focus
        views = tuple(TrainingView(v.name, v.camera, read(v)) for v in self.views if v.split == "train")
        few = PointCloud(np.zeros((3, 3)), np.zeros((3, 3), np.float32), np.zeros(3, np.float32))
        return TrainingSet(views, few if self.has_points else None)


def fake_facts(folder: Path, checksum: str, inputs: str) -> Facts:
    """What the photographs of a fake dataset would show: by its dataset.json, since they are mere noise."""
    dataset = FakeDataset(folder)
    blur = 0.1 if inputs == "all-in-focus" else dataset.views[-1].max_coc_px
    return Facts(900 if dataset.has_points else 0, blur, 20.0, dataset.assign == "fixed", 20.0)


def sharp_image(seed: int, camera: Camera) -> np.ndarray:
    """What the fake scene looks like from a camera; the fake method knows it too."""
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    phase = seed + camera.world_to_camera[0, 3]
    waves = [np.sin(x / (7 + 3 * c) + phase) * np.cos(y / (9 - 2 * c) - phase) for c in range(3)]
    return from_8bit(to_8bit(0.5 + 0.4 * np.stack(waves, axis=2)))


def write_dataset(
    folder: Path,
    *,
    name: str = "waves",
    seed: int = 1,
    train: int = 4,
    test: int = 2,
    coc: float = 4.0,
    points: bool = True,
    assign: str = "per-view",
    exact: bool = True,
    unknown: Sequence[str] = (),
    blurred: Sequence[str] = (),
    flat: Sequence[str] = (),
) -> Path:
    """Write the dataset.json that `FakeDataset` reads; returns the folder. unknown, blurred, flat: the views without a
    known lens, a sharp photograph, depth."""
    folder.mkdir(parents=True, exist_ok=True)
    choices = {"name": name, "seed": seed, "train": train, "test": test, "coc": coc, "points": points}
    choices |= {"assign": assign, "exact": exact, "unknown": [*unknown], "blurred": [*blurred], "flat": [*flat]}
    (folder / "dataset.json").write_text(json.dumps(choices))
    return folder


METHOD_TOML = """\
name = "{name}"
summary = "A fake"
paper = "Nobody, 2020"
class = "trainer:Fake"
default_preset = "quick"

[capabilities]
refocus = {refocus}
learns_lens = {learns_lens}
needs_points = {needs_points}

[presets.quick]
budget = "8it"

[presets.slow]
steps = 12
noise = 0.2

[leave_out.lens]
lens = false

[leave_out.lens_per_view]
lens_per = "scene"

[leave_out.sparse_depth]
depth = 0

[leave_out.normals]
normals = 0

[leave_out.harmonics]
harmonics = 0

[leave_out.colours]
colours = 0

[claims]
source = "Nobody 2020, Table 1"
rows = {{ "their own data" = {{ psnr = 28.7, delta_a = 0.126 }} }}
"""

METHOD_CODE = '''\
"""A method that knows the answer and adds noise that shrinks while it trains."""

import json

import numpy as np
from harness_fakes import sharp_image

from dofbench.core.contracts import Decision, FitOutcome, Rendering
from dofbench.core.errors import InputError, Status
from dofbench.core.lens import PhysicalLens

from .behaviour import misbehave

DEFAULTS = {"steps": 8, "noise": 0.1, "lens": True, "trouble": "", "at": 3, "scene": 1, "pause": 0.0,
            "lens_per": "view", "depth": 1, "normals": 1, "harmonics": 3, "colours": 1}


class Fake:
    def __init__(self, options, seed, device):
        unknown = sorted(set(options) - set(DEFAULTS))
        if unknown:
            raise InputError(f"option {unknown[0]}", "an unknown name", f"one of {', '.join(sorted(DEFAULTS))}")
        self.options = {**DEFAULTS, **options}
        self.seed, self.step, self.widths = seed, 0, {}

    def fit(self, training_set, budget, observer):
        self.widths = {view.name: view.camera.width for view in training_set.views}
        for step in range(1, (budget.steps or 10**9) + 2):
            self.step = step
            loss = misbehave(self.options, step, 1.0 / step)
            deaf = self.options["trouble"] == "deaf" and step >= self.options["at"]
            if not observer.after_step(step, loss) and not deaf:
                break
        decisions = ()
        if self.options["trouble"] == "no lens":  # training finds that there is none
            self.options["lens"] = False
            decisions = (Decision("lens", False, "tried while training: nothing gained"),)
        return FitOutcome(Status.OK, step, stages={"guess": 0.01}, left_out={"normals": "a fake has none"},
                          decisions=decisions)

    def render(self, camera, lens):
        if lens is not None and not self.options["lens"]:
            raise ValueError("no lens here")
        image = sharp_image(self.options["scene"], camera).astype(np.float32)
        if lens is not None:
            image = image * (1 - 0.1 * round(lens.aperture / (0.02 * lens.width / 0.5), 3))
        random = np.random.default_rng(self.seed)
        image = image + random.normal(0, self.options["noise"] / max(self.step, 1), image.shape)
        if self.options["trouble"] == "hole":
            image[0, 0, 0] = np.nan
        return Rendering(image.astype(np.float32), np.ones(image.shape[:2], np.float32))

    def lens_estimates(self):
        if not self.options["lens"]:
            return None
        return {name: PhysicalLens(5.0, 0.3, width) for name, width in self.widths.items()}

    def describe(self):
        return {"gaussians": 10.0 * self.step}

    def save(self, folder):
        (folder / "model.json").write_text(json.dumps([self.step, self.widths, self.options["lens"]]))

    def load(self, folder):
        self.step, self.widths, self.options["lens"] = json.loads((folder / "model.json").read_text())
'''

BEHAVIOUR_CODE = '''\
"""How a fake goes wrong, by the option `trouble`."""

import math
import time

from dofbench.compute import kernel_cache
from dofbench.core.errors import InputError


def misbehave(options, step, loss):
    time.sleep(options["pause"])
    if step < options["at"]:
        return loss
    match options["trouble"]:
        case "lost":
            return math.nan
        case "crash":
            raise RuntimeError("something broke")
        case "memory":
            raise MemoryError("no more")
        case "overflow":
            raise FloatingPointError("overflow in exp")
        case "interrupt":
            raise KeyboardInterrupt
        case "interrupt-in-kernel":
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as stop:
                raise SystemError("a compiled function returned a result with an exception set") from stop
        case "input":
            raise InputError("points", "none", "some")
        case "compile" if step == options["at"]:
            kernel_cache._compiled += 2
    return loss
'''


def write_method(
    root: Path,
    method: str = "fake",
    *,
    refocus: bool = True,
    learns_lens: bool = True,
    needs_points: bool = True,
    toml: str = METHOD_TOML,
) -> Path:
    """Write a method folder below `root`; returns `root`, for DOFBENCH_METHODS."""
    folder = root / method
    folder.mkdir(parents=True)
    words = {
        "name": method.capitalize(),
        "refocus": str(refocus).lower(),
        "learns_lens": str(learns_lens).lower(),
        "needs_points": str(needs_points).lower(),
    }
    (folder / "method.toml").write_text(toml.format(**words))
    (folder / "trainer.py").write_text(METHOD_CODE)
    (folder / "behaviour.py").write_text(BEHAVIOUR_CODE)
    return root


def fake_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., RunEnd]:
    """A function that runs the fake method (or, with method="pinhole", one without a lens) on the fake
    dataset in `folder`/data, into `folder`/results; keywords replace those of `Run`."""
    methods = write_method(folder / "methods")
    write_method(methods, "pinhole", refocus=False, learns_lens=False)
    monkeypatch.setenv("DOFBENCH_METHODS", str(methods))
    for module in (check_module, planned_module, prepare_module, score_module, truth_module):
        monkeypatch.setattr(module, "Dataset", FakeDataset)
    monkeypatch.setattr(prepare_module, "_facts", fake_facts)
    # FLIP takes a third of a second however small the image; what it says is tested elsewhere.
    quick = replace(METRICS["flip"], function=lambda prediction, truth: float(np.abs(prediction - truth).mean()))
    monkeypatch.setitem(METRICS, "flip", quick)
    data = write_dataset(folder / "data")

    def call(console: Console | None = None, **changes) -> RunEnd:
        settings = Run(**{"method": "fake", "data": data, "out": folder / "results", **changes})
        return run_module.run(settings, console or Console(quiet=True))

    return call


class Here:
    """Runs jobs in this process, where the fakes are; `fatal` ends the call at the n-th, as a killed process would."""

    def __init__(self, fatal: int | None = None):
        self.made: list[str] = []
        self.fatal = fatal

    def __call__(self, jobs: list[Job], *, workers: int, watcher) -> list[Outcome]:
        outcomes = []
        for job in jobs:
            if self.fatal is not None and len(self.made) == self.fatal:
                raise KeyboardInterrupt
            self.made.append(job.name)
            watcher.started(job.name)
            try:
                outcome = Outcome(job.name, job.work(partial(watcher.reported, job.name)))
            except Exception as error:
                outcome = Outcome(job.name, problem=one_line(error) or repr(error))
            watcher.ended(outcome)
            outcomes.append(outcome)
        return outcomes


def text_console() -> tuple[Console, io.StringIO]:
    """A console without colours, and what is said on it."""
    stream = io.StringIO()
    return Console(file=stream, width=200), stream
