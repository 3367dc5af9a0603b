"""A method folder that costs nothing, its mishaps, and runs of it, for the tests of the harness and of the reports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from small_dataset import write_dataset

from dofbench.core.budget import parse_budget
from dofbench.core.jobs import Outcome
from dofbench.evaluation.metrics import METRICS
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.one_run import run

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

{stages}
[stages.sparse_depth]
decided_by = "points"
option = "depth"
off = 0

[stages.normals]
decided_by = "depth_supervision"
option = "normals"
off = 0

[stages.harmonics]
decided_by = "view_dependence"
option = "harmonics"
off = 0

[stages.colours]
decided_by = "colour_spread"
option = "colours"
off = 0

[claims]
source = "Nobody 2020, Table 1"
rows = {{ "their own data" = {{ psnr = 28.7, delta_a = 0.126 }} }}
"""

LENS_STAGES = """\
[stages.lens]
decided_by = "lens"
option = "lens"
off = false

[stages.lens_per_view]
decided_by = "one_lens"
option = "lens_per"
off = "scene"
"""

METHOD_CODE = '''\
"""A method that knows the answer and adds noise that shrinks while it trains."""

import json

import numpy as np
from small_dataset import sharp_image, smooth_image

from dofbench.core.contracts import Decision, FitOutcome, Rendering
from dofbench.core.errors import InputError, Status
from dofbench.core.lens import PhysicalLens

from .behaviour import misbehave

DEFAULTS = {"steps": 8, "noise": 0.1, "lens": True, "trouble": "", "at": 3, "scene": 1, "pause": 0.0,
            "lens_per": "view", "depth": 1, "normals": 1, "harmonics": 3, "colours": 1}


class Fake:
    @classmethod
    def read_options(cls, options):
        unknown = sorted(set(options) - set(DEFAULTS))
        if unknown:
            raise InputError(f"option {unknown[0]}", "an unknown name", f"one of {', '.join(sorted(DEFAULTS))}")
        return {**DEFAULTS, **options}

    def __init__(self, options, seed, device):
        self.options = self.read_options(options)
        self.seed, self.step, self.widths = seed, 0, {}

    def fit(self, training_set, budget, observer):
        self.widths = {view.name: view.camera.width for view in training_set.views}
        self.cameras = {view.name: view.camera for view in training_set.views}
        for step in range(1, (budget.steps or 10**9) + 2):
            self.step = step
            loss = misbehave(self.options, step, 1.0 / step)
            deaf = self.options["trouble"] == "deaf" and step >= self.options["at"]
            if not observer.after_step(step, loss) and not deaf:
                break
        decisions = ()
        if self.options["trouble"] == "no lens":  # training finds that there is none
            self.options["lens"] = False
            decisions = (Decision("lens", False, "held-out PSNR +0.00 dB with the lens"),)
        return FitOutcome(Status.OK, step, stages={"guess": 0.01}, left_out={"normals": "a fake has none"},
                          decisions=decisions)

    def render(self, camera, lens):
        if lens is not None and not self.options["lens"]:
            raise ValueError("no lens here")
        image = (sharp_image if lens is None else smooth_image)(self.options["scene"], camera).astype(np.float32)
        if lens is not None:
            image = image * (1 - 0.1 * round(lens.aperture / (0.02 * lens.width / 0.5), 3))
        random = np.random.default_rng(self.seed)
        image = image + random.normal(0, self.options["noise"] / max(self.step, 1), image.shape)
        if self.options["trouble"] == "hole":
            image[0, 0, 0] = np.nan
        return Rendering(image.astype(np.float32), np.ones(image.shape[:2], np.float32))

    def predict_photograph(self, name, pixels):
        noise = np.random.default_rng(0).normal(0, self.options["noise"] / self.step, (*pixels.shape, 1))
        return np.where(pixels[..., None], smooth_image(self.options["scene"], self.cameras[name]) + noise, np.nan)

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

from dofbench.runtime import kernel_cache
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
        "stages": LENS_STAGES if learns_lens else "",
    }
    (folder / "method.toml").write_text(toml.format(**words))
    (folder / "trainer.py").write_text(METHOD_CODE)
    (folder / "behaviour.py").write_text(BEHAVIOUR_CODE)
    return root


def fake_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """A function that runs the fake method (or, with method="pinhole", one without a lens) on the small
    dataset in `folder`/data, into `folder`/results; keywords replace those of `Run`,
    a budget as text."""
    methods = write_method(folder / "methods")
    write_method(methods, "pinhole", refocus=False, learns_lens=False)
    monkeypatch.setenv("DOFBENCH_METHODS", str(methods))
    # FLIP takes a third of a second even for small images; its values are tested elsewhere.
    quick = replace(METRICS["flip"], function=lambda prediction, truth: float(np.abs(prediction - truth).mean()))
    monkeypatch.setitem(METRICS, "flip", quick)
    data = write_dataset(folder / "data")

    def call(console: Console | None = None, **changes) -> Outcome:
        if "budget" in changes:
            changes["budget"] = parse_budget(changes["budget"])
        settings = RunSpec(**{"method": "fake", "data": data, "out": folder / "results", **changes})
        return run(settings, console or Console(quiet=True))

    return call
