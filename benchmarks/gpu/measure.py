"""Measure a GPU in one go: agreement with the CPU, times, trainings and memory, as CSVs.

    python -m benchmarks.gpu.measure --out reports/gpu --data data/fern data/foliage-1008

Parts, each kept in --work as soon as it is done, so that the same command resumes; parts that were made by other code
or on another GPU are made again:

- machine: the GPU, its driver, and the bandwidth of its memory, measured by copying.
- agreement: value and gradient of every op against the CPU backend's.
- ops: the time of every op, forward and with its gradient, and its floor, which is reading and writing its tensors once
  at the measured bandwidth; and gsplat's rasteriser on the same Gaussians, where it can be imported.
- cost: the rasteriser and the scatter renderer over numbers of Gaussians, pixels and radii.
- step: a training step on each dataset: its kernels, their launches, and what the host does meanwhile.
- training: LensSelect on each dataset for 5 000 and for 30 000 steps: scores, time, frames per second, memory.

It needs a GPU and `pip install dofbench[gpu]`; no internet. Datasets are made before, on any machine (docs/gpu.md has
the commands); one that isn't there is named and skipped. A part that fails is reported with its error, and the others
go on. Nothing begins after `--minutes`. `tables.py` writes the CSVs, `python benchmarks/make_pages.py gpu` the page.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console
from torch import Tensor

from benchmarks.gpu.calls import CALLS, Call, Size, gradients
from benchmarks.gpu.peer import both, gsplat
from benchmarks.gpu.step import is_kernel, profiler, step_parts
from benchmarks.gpu.tables import SCORES, write_tables
from dofbench.core.budget import Budget
from dofbench.core.files import read_json, write_json
from dofbench.core.lens import PhysicalLens
from dofbench.datasets.format.schema import MANIFEST
from dofbench.evaluation.results.provenance import code_version, git_state, package_versions
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.methods.cards import find_method
from dofbench.running.load_run import load_run
from dofbench.running.one_run import run

DEVICE = "cuda"
CLOSE = 1e-5


@dataclass(frozen=True)
class Settings:
    """What to measure."""

    out: Path
    """Folder of the CSVs; rows of other GPUs stay."""
    work: Path = Path("results/gpu")
    """Folder of gpu.json, which holds the finished parts, and of the trainings."""
    data: tuple[Path, ...] = ()
    """Datasets to train on."""
    minutes: float = 8.0
    """Minutes after which no part begins."""
    steps: tuple[int, ...] = (5000, 30000)
    """Lengths of the trainings."""
    preset: str = "gpu"
    """Preset of the trainings."""
    warm: int = 2000
    """Warm-up steps before the profiled ones."""
    profiled: int = 20
    """Profiled steps."""
    size: Size = Size()
    """Size of the ops' calls."""
    counts: tuple[int, ...] = (10_000, 100_000, 1_000_000, 5_000_000)
    """Numbers of Gaussians of the part cost."""
    widths: tuple[int, ...] = (252, 504, 1008, 2016)
    """Image widths of the part cost, pixels, at 4:3."""
    radii: tuple[float, ...] = (2.0, 8.0, 32.0)
    """Largest CoC radii of the part cost, pixels."""
    repeats: int = 20
    """Calls whose median is taken."""
    only: tuple[str, ...] = ()
    """Parts to make, by the beginnings of their names; all by default."""


def milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Median time of a call on the GPU, ms, after two warm-up calls."""
    times = []
    for number in range(repeats + 2):
        torch.cuda.synchronize()
        start = time.perf_counter()
        call()
        torch.cuda.synchronize()
        if number > 1:
            times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def busy(call: Callable[[], object], repeats: int) -> float:
    """GPU time of a call, ms: the sum of its kernels, without gaps."""
    call()
    torch.cuda.synchronize()
    with profiler() as seen:
        for _ in range(repeats):
            call()
        torch.cuda.synchronize()
    return sum(event.self_device_time_total for event in seen.key_averages() if is_kernel(event)) / 1e3 / repeats


def machine(settings: Settings) -> dict[str, Any]:
    """The GPU and its memory."""
    words = ["nvidia-smi", "--query-gpu=driver_version,power.limit,clocks.max.sm", "--format=csv,noheader"]
    try:
        says = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError) as error:
        says = f"nothing: {error}"
    size = settings.size.width * settings.size.height * 512
    source = torch.empty(size, dtype=torch.float32, device=DEVICE)
    target = torch.empty_like(source)
    took = milliseconds(lambda: target.copy_(source), settings.repeats)
    properties = torch.cuda.get_device_properties(DEVICE)
    return {
        "gpu": properties.name,
        "memory_gb": properties.total_memory / 1e9,
        "multiprocessors": properties.multi_processor_count,
        "nvidia_smi": says,
        "copy_gb_per_s": 2 * 4 * size / took / 1e6,
        "packages": package_versions(),
    }


def agreement(settings: Settings) -> dict[str, Any]:
    """Largest differences from the CPU backend, over the largest magnitude; and the share of the values that differ by
    more than `CLOSE` of it, since rounding decides at a threshold, such as the least opacity that is drawn. repeats: 1
    if a second call gives the same bits. value_each, gradient_each: the two for every result, and every input.
    gsplat's differences are from this project's rasteriser on the GPU."""
    size = replace(settings.size, gaussians=min(settings.size.gaussians, 20_000))
    found = {}
    for name, make in CALLS.items():
        call = make(size)
        found[name] = _differences(gradients(call, call.on("cpu")), call)
    try:
        ours, theirs = both(size)
        found["gsplat"] = _differences(gradients(ours, ours.on(DEVICE)), theirs)
    except ImportError:
        pass  # `ops` says so
    return found


def _differences(expected: tuple[list[Tensor], list[Tensor]], call: Call) -> dict[str, Any]:
    """How far the values and gradients of a call on the GPU are from those that are expected."""
    there, again = (gradients(call, call.on(DEVICE)) for _ in range(2))
    pairs = zip((*there[0], *there[1]), (*again[0], *again[1]), strict=True)
    found: dict[str, Any] = {"repeats": int(all(torch.equal(*pair) for pair in pairs))}
    for what, ours, theirs in zip(("value", "gradient"), expected, there, strict=True):
        if ours:
            each = [_apart(*pair).flatten() for pair in zip(ours, theirs, strict=True)]
            found[what], found[f"{what}_share"] = _largest_and_share(torch.cat(each))
            found[f"{what}_each"] = [_largest_and_share(apart) for apart in each]
    return found


def _largest_and_share(apart: Tensor) -> list[float]:
    return [float(apart.max()), float((apart > CLOSE).float().mean())]


def _apart(here: Tensor, there: Tensor) -> Tensor:
    here, there = here.detach().cpu().double(), there.detach().cpu().double()
    return (there - here).abs() / here.abs().max().clamp_min(1e-30)


def ops(settings: Settings) -> dict[str, Any]:
    """Times of forward, and of forward and gradient, with the bytes that both must move at least."""
    found = {}
    for name, make in CALLS.items():
        found[name] = _timed(make(settings.size), settings.repeats)
    try:
        found["gsplat"] = _timed(gsplat(settings.size), settings.repeats)
    except ImportError as error:
        found["gsplat"] = {"left_out": str(error)}
    return found


def _timed(call: Call, repeats: int) -> dict[str, float]:
    inputs = call.on(DEVICE)
    values, slopes = gradients(call, inputs)
    moved = 4 * sum(value.numel() for value in (*inputs, *values))
    with torch.no_grad():
        forward = milliseconds(lambda: call.run(*inputs), repeats)
        works = busy(lambda: call.run(*inputs), repeats)
    found = {"forward_ms": forward, "forward_busy_ms": works, "forward_bytes": moved}
    if call.learns:
        found["both_ms"] = milliseconds(lambda: gradients(call, inputs), repeats)
        found["both_busy_ms"] = busy(lambda: gradients(call, inputs), repeats)
        found["both_bytes"] = 2 * moved + 4 * sum(slope.numel() for slope in slopes)
    return found


def cost(settings: Settings) -> dict[str, Any]:
    """Forward and gradient, ms, and the most memory, MB, as one quantity varies."""
    found: dict[str, Any] = {"gaussians": {}, "width": {}, "radius": {}}
    sizes = [("gaussians", count, replace(settings.size, gaussians=count)) for count in settings.counts]
    sizes += [("width", one, replace(settings.size, width=one, height=one * 3 // 4)) for one in settings.widths]
    sizes += [("radius", one, replace(settings.size, radius=one)) for one in settings.radii]
    for what, value, size in sizes:
        torch.cuda.reset_peak_memory_stats()
        try:
            took = _timed(CALLS["scatter" if what == "radius" else "rasterize"](size), max(settings.repeats // 4, 1))
        except torch.OutOfMemoryError as error:
            found[what][str(value)] = {"varied": value, "left_out": str(error).partition(".")[0]}
            continue
        megabytes = torch.cuda.max_memory_allocated() / 1e6
        times = {name: took[name] for name in ("forward_ms", "both_ms")}
        found[what][str(value)] = {"varied": value, **times, "peak_mb": megabytes}
    return found


def step(settings: Settings, data: Path) -> dict[str, Any]:
    """Profile a training step of LensSelect."""
    if not (data / MANIFEST).is_file():
        return {"left_out": f"{data} is no dataset"}
    return step_parts(data, "lensselect", settings.preset, DEVICE, settings.warm, settings.profiled)


def training(settings: Settings, data: Path, steps: int) -> dict[str, Any]:
    """Train on a dataset, and time how fast the model renders a test view."""
    if not (data / MANIFEST).is_file():
        return {"left_out": f"{data} is no dataset"}
    budget = Budget(steps=steps)
    wanted = RunSpec(
        method="lensselect",
        preset=settings.preset,
        data=data,
        budget=budget,
        device=DEVICE,
        out=settings.work / "runs",
    )
    end = run(wanted, Console(quiet=True))
    result = read_result(end.folder)
    found: dict[str, Any] = {"status": result.status, "message": result.message}
    found |= {name: result.scores[name] for name in SCORES if name in result.scores}
    found["peak_mb"] = result.description.get("device_peak_mb")
    found["stages"] = dict(result.method_stages)
    if not end:
        return found
    loaded = load_run(end.folder)
    view, exposures = loaded.dataset.test_views()[0], loaded.method.renderer
    for name, lens in (("fps", None), ("fps_lens", view.physical_lens)):

        def shown(lens: PhysicalLens | None = lens) -> object:
            # A new camera, since the last one's image is cached. The image stays on the GPU, as in a viewer.
            return exposures.image_and_depth(replace(view.camera), lens)

        found[name] = 1e3 / milliseconds(shown, settings.repeats)
    return found


def parts(settings: Settings) -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """The parts by name, the most informative in the least time first."""
    for name, part in (("machine", machine), ("ops", ops), ("agreement", agreement)):
        yield name, lambda part=part: part(settings)
    for data in settings.data:
        yield f"step {data.name}", lambda data=data: step(settings, data)
    for steps in settings.steps:
        for data in settings.data:
            yield f"training {data.name} {steps}", lambda data=data, steps=steps: training(settings, data, steps)
    yield "cost", lambda: cost(settings)


def measure(settings: Settings) -> dict[str, Any]:
    """Make every missing part, keep each at once, and return all."""
    file = settings.work / "gpu.json"
    head = {"gpu": torch.cuda.get_device_name(DEVICE), "code": code_version(find_method("lensselect").folder, DEVICE)}
    found = read_json(file) if file.is_file() else {}
    if {name: found.get(name) for name in head} != head:
        found = {**head, "commit": git_state(), "parts": {}}
    begun = time.monotonic()
    for name, make in parts(settings):
        if name in found["parts"] or not name.startswith(settings.only or ""):
            continue
        if time.monotonic() - begun > 60 * settings.minutes:
            break
        start = time.monotonic()
        try:
            done = make()
        except Exception as error:  # the others go on
            traceback.print_exc()
            found.setdefault("failed", {})[name] = f"{type(error).__name__}: {error}"
            continue
        found["parts"][name] = {**done, "seconds": time.monotonic() - start}
        found.get("failed", {}).pop(name, None)
        write_json(file, found)
        print(f"{name}: {time.monotonic() - start:.0f} s", flush=True)
    write_json(file, found)
    return found


def main(settings: Settings) -> int:
    """Make what is missing and write the CSVs; 1 where a part failed."""
    if not torch.cuda.is_available():
        print("no GPU that torch can use: torch.cuda.is_available() is False", file=sys.stderr)
        return 2
    found = measure(settings)
    write_tables(settings.out, found)
    for name, problem in found.get("failed", {}).items():
        print(f"failed: {name}: {problem}", file=sys.stderr)
    return 1 if found.get("failed") else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings, description=__doc__)))
