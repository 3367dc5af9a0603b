"""A method folder that costs nothing and a small dataset, for the tests of the harness and of the reports."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from made_up import cloud, frontal
from rich.console import Console

from dofbench.core.budget import parse_budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import one_line
from dofbench.core.evidence import Role
from dofbench.core.files import sha256_file, sha256_text, write_json
from dofbench.core.images import from_8bit, to_8bit, write_exr, write_png
from dofbench.core.jobs import Job, Outcome, Watcher
from dofbench.core.lens import DisparityRange, Lens, SceneRenderer
from dofbench.dataset import layout
from dofbench.dataset.points_record import PointsRecord
from dofbench.dataset.schema import (
    ALL_KNOWN,
    LENS_FILE,
    MANIFEST,
    SCHEMA,
    SOME_UNKNOWN,
    STATED,
    DepthRecord,
    FileRecord,
    LensFile,
    Manifest,
    ShapeRecord,
    SourceImage,
    SourceRecord,
    ThinLensRecord,
    UnknownLens,
    UnknownLensFile,
    ViewRecord,
    as_json,
)
from dofbench.metrics import METRICS
from dofbench.results.run_spec import Run
from dofbench.running.one_run import RunEnd, run
from dofbench.scenes import export
from dofbench.scenes.scene import Split

WIDTH, HEIGHT = 64, 48
RANGE = DisparityRange(0.1, 0.6)
_THIN_LENS = ThinLensRecord(recipe="attic", seed=20261104, samples=512, mitsuba="0", variant="scalar_rgb")


def smooth_image(seed: int, camera: Camera) -> np.ndarray:
    """The fake scene seen by a camera through a lens: smooth waves, darker for every second camera."""
    return from_8bit(to_8bit(_light(camera) * _waves(seed, camera)))


def sharp_image(seed: int, camera: Camera) -> np.ndarray:
    """The scene without a lens, which has fine detail besides. The fake method knows both."""
    random = np.random.default_rng(seed)
    squares = (
        random.uniform(size=(-(-camera.height // 4), -(-camera.width // 4), 1)).repeat(4, axis=0).repeat(4, axis=1)
    )
    detail = squares[: camera.height, : camera.width]
    return from_8bit(to_8bit(_light(camera) * (0.5 * _waves(seed, camera) + 0.5 * detail)))


def _waves(seed: int, camera: Camera) -> np.ndarray:
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    phase = seed + camera.world_to_camera[0, 3]
    waves = [np.sin(x / (7 + 3 * c) + phase) * np.cos(y / (9 - 2 * c) - phase) for c in range(3)]
    return 0.5 + 0.4 * np.stack(waves, axis=2)


def _light(camera: Camera) -> float:
    return 0.7 if round(camera.world_to_camera[0, 3]) % 2 else 1.0


def write_dataset(
    folder: Path,
    *,
    name: str = "waves",
    seed: int = 1,
    train: int = 4,
    test: int = 2,
    in_focus: bool = False,
    points: bool = True,
    assign: str = "per-view",
    exact: bool = True,
    unknown: Sequence[str] = (),
    blurred: Sequence[str] = (),
    flat: Sequence[str] = (),
    role: Role | None = None,
    role_by: str | None = None,
    renderer: SceneRenderer = "scatter",
    stated: PointsRecord | None = None,
) -> Path:
    """Write a small dataset of views v0, v1, ..., the test views first; returns the folder.

    Of the scene a lens shows `smooth_image`, darkened by the aperture, and so does the fake method. in_focus: the
    shallow photographs have all the detail of the sharp ones. exact: whether the depth is the scene's own, or
    estimated. unknown, blurred, flat: the views without a known lens, a sharp photograph, depth. stated: where the
    points come from, None for an older dataset, which doesn't say. role, role_by: as the manifest states them.
    renderer: what the lenses' file says that took the photographs.
    """
    shutil.rmtree(folder, ignore_errors=True)
    names = [f"v{index}" for index in range(test + train)]
    splits: list[Split] = ["test" if index < test else "train" for index in range(test + train)]
    cameras = [_camera(index) for index in range(test + train)]
    depth = np.linspace(2.0, 9.0, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    shallow = sharp_image if in_focus else smooth_image
    for index, (view, camera) in enumerate(zip(names, cameras, strict=True)):
        write_png(layout.shallow_path(folder, view), shallow(seed, camera) * (1 - 0.1 * _lens(index).aperture))
        if view not in blurred:
            write_png(layout.sharp_path(folder, view), sharp_image(seed, camera))
        if view not in flat:
            write_exr(layout.depth_path(folder, view), depth)
    images = [layout.relative(layout.shallow_path, view) for view in names]
    sparse = _points(len(cameras)) if points else None
    export.write_colmap(folder, [Path(file).name for file in images], cameras, sparse)
    export.write_transforms(folder / layout.TRANSFORMS, images, cameras, splits=splits)
    lenses = _lens_file(dict(zip(names, splits, strict=True)), unknown, flat, renderer)
    write_json(folder / LENS_FILE, as_json(lenses))
    files = {
        file.relative_to(folder).as_posix(): FileRecord(sha256=sha256_file(file), size=file.stat().st_size)
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
    source = SourceRecord(
        scene=name.split("_")[0],
        layout="none",
        geometry=sha256_text(name),
        images=tuple(
            SourceImage(view=view, sha256=sha256_text(view), photograph="shallow" if view in unknown else None)
            for view in names
        ),
        role=role,
        role_by=role_by,
    )
    measured = DepthRecord(source="given" if exact else "sfm", provenance={}) if set(names) - set(flat) else None
    record = Manifest(
        schema=SCHEMA,
        version=STATED if stated else SOME_UNKNOWN if unknown or measured is None else ALL_KNOWN,
        name=name,
        dofbench="0",
        command="none",
        identity=sha256_text(name),
        seed=seed,
        settings={"assign": assign},
        source=source,
        depth=measured,
        points=stated,
        files=files,
    )
    write_json(folder / MANIFEST, as_json(record))
    return folder


def _camera(index: int) -> Camera:
    return frontal(WIDTH, HEIGHT, 200.0, (-index, 0.0, 0.0))


def _lens(index: int) -> Lens:
    return Lens(aperture=(0.5, 1.0)[index % 2], focus=(0.2, 0.5, 0.8)[index % 3])


def _points(views: int) -> PointCloud:
    """Points far away, so that every view sees all, and numerous enough to estimate the blur of the photographs."""
    across, down = np.meshgrid(np.linspace(-10.0, 10.0, 16), np.linspace(-10.0, 10.0, 10))
    xyz = np.stack([across.ravel() - 2.5, down.ravel(), np.full(across.size, 100.0)], axis=1)
    return cloud(xyz, [np.arange(views) for _ in xyz], rgb=np.full(xyz.shape, 0.5))


def _lens_file(
    splits: dict[str, Split], unknown: Sequence[str], flat: Sequence[str], renderer: SceneRenderer
) -> LensFile | UnknownLensFile:
    measured = bool(splits.keys() - set(flat))
    records = []
    for index, (view, split) in enumerate(splits.items()):
        lens, physical = _lens(index), _lens(index).physical(RANGE, WIDTH)
        known = ViewRecord(
            name=view,
            split=split,
            aperture=lens.aperture,
            focus=lens.focus,
            k_px=0.02 * WIDTH * lens.aperture,
            aperture_scene=physical.aperture,
            focus_scene=1 / physical.focus_disparity,
            max_coc_px=4.0,
        )
        records.append(UnknownLens(name=view, split=split, lens="unknown") if view in unknown else known)
    if splits and splits.keys() <= set(unknown):
        return UnknownLensFile(disparity_range=(RANGE.q_min, RANGE.q_max) if measured else None, views=tuple(records))
    return LensFile(
        disparity_range=(RANGE.q_min, RANGE.q_max),
        normaliser="scene",
        gamma=2.2,
        alpha=4.0,
        energy="area",
        shape=ShapeRecord(blades=0, rotation=0.0, curvature=0.0, obstruction=0.0),
        renderer=renderer,
        thinlens=_THIN_LENS if renderer == "thinlens" else None,
        views=tuple(records),
    )


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
from harness_fakes import sharp_image, smooth_image

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
        image = (sharp_image if lens is None else smooth_image)(self.options["scene"], camera).astype(np.float32)
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
        "stages": LENS_STAGES if learns_lens else "",
    }
    (folder / "method.toml").write_text(toml.format(**words))
    (folder / "trainer.py").write_text(METHOD_CODE)
    (folder / "behaviour.py").write_text(BEHAVIOUR_CODE)
    return root


def fake_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., RunEnd]:
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

    def call(console: Console | None = None, **changes) -> RunEnd:
        if "budget" in changes:
            changes["budget"] = parse_budget(changes["budget"])
        settings = Run(**{"method": "fake", "data": data, "out": folder / "results", **changes})
        return run(settings, console or Console(quiet=True))

    return call


class Here:
    """An executor in this process, where the fakes are. `fatal` ends the call at the n-th, as if it were killed."""

    at_a_time = 1

    def __init__(self, fatal: int | None = None):
        self.made: list[str] = []
        self.fatal = fatal

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """Do them one after another; one that fails doesn't stop the others."""
        outcomes = []
        for job in jobs:
            if self.fatal is not None and len(self.made) == self.fatal:
                raise KeyboardInterrupt
            self.made.append(job.name)
            watcher.started(job.name)
            try:
                work = job.insist if job.insist and job.busy() else job.work
                outcome = Outcome(job.name, work(partial(watcher.reported, job.name)))
            except Exception as error:
                outcome = Outcome(job.name, problem=one_line(error) or repr(error))
            watcher.ended(outcome)
            outcomes.append(outcome)
        return outcomes


def text_console() -> tuple[Console, io.StringIO]:
    """A console without colours, and what is said on it."""
    stream = io.StringIO()
    return Console(file=stream, width=200), stream
