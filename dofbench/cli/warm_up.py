"""`dofbench warm-up`: compile kernels before the first run, for the image of a container or many jobs."""

from __future__ import annotations

import io
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from dofbench.core.errors import InputError
from dofbench.core.options import options

ALL = "all"
_WIDTH = 64  # pixels of the tiny dataset's images


@options()
class WarmUp:
    """Compile the kernels of methods into the cache on disk, so that no run has to, and train each method for 2 steps.
    NUMBA_CACHE_DIR names the cache, NUMBA_CPU_NAME another processor (x86-64-v3); runs need the same."""

    method: str = "lensselect"
    """Ids of methods, comma-separated; all for every method that trains here."""

    device: str = "cpu"
    """Device that the methods train on: cpu, cuda, or auto."""


def warm_up(settings: WarmUp) -> bool:
    """Compile and say where to; False where a method's training failed. What is compiled already is only loaded.

    Raises InputError for an unknown method, and where no folder of the cache can be written.
    """
    from rich.console import Console

    from dofbench.core.progress import Terminal, say
    from dofbench.methods.cards import find_method, method_files
    from dofbench.runtime import kernel_cache
    from dofbench.runtime.compilation import compile_all

    console, started = Console(stderr=True), perf_counter()
    every = settings.method == ALL
    entries = [find_method(name) for name in (method_files() if every else settings.method.split(","))]
    entries = [one for one in entries if not every or (one.card.capabilities.trains and not one.card.elsewhere)]
    ops = dict.fromkeys(op for entry in entries for op in entry.card.kernels)
    with Terminal(console).uncounted("JIT compilation"):
        compile_all([*ops.keys() - {"scatter", "tone"}, "tone", "scatter"])  # datasets need these two
    if not kernel_cache.stored():
        raise InputError("the kernel cache", "no folder that can be written", "one, named by NUMBA_CACHE_DIR")
    failed = _train([entry.id for entry in entries], settings.device)
    for line in failed:
        say(console, line)
    print(_summary(kernel_cache.stored(), kernel_cache.processor(), perf_counter() - started))
    return not failed


def _train(methods: list[str], device: str) -> list[str]:
    """Train every method for two steps on a tiny dataset: what is compiled for other types than usual is compiled then.

    Returns what went wrong, a line for each failure.
    """
    from rich.console import Console

    from dofbench.core.budget import Budget
    from dofbench.core.errors import Status
    from dofbench.core.progress import Silent
    from dofbench.datasets.synthesis import make_dataset
    from dofbench.datasets.synthesis.dataset_options import MakeDataset
    from dofbench.evaluation.results.collecting import collect
    from dofbench.running.matrix import run_all
    from dofbench.running.run_options import Runs

    with TemporaryDirectory(prefix="dofbench-") as name:
        folder, silent = Path(name), Console(file=io.StringIO())
        make_dataset(MakeDataset(width=_WIDTH, out=folder / "data"), progress=Silent())
        run = Runs(
            method=",".join(methods), data=str(folder / "data"), budget=(Budget(steps=2),), device=device,
            out=folder / "out",
        )  # fmt: skip
        if run_all(run, folder / "data", silent):
            return []
        ended = [entry for entry in collect(folder / "out").entries if entry.status is not Status.OK]
        return [f"{entry.spec.method}: {entry.status}: {entry.message}" for entry in ended]


def _summary(files: list[Path], processor: str, seconds: float) -> str:
    places = os.path.commonpath([file.parent for file in files])
    size = sum(file.stat().st_size for file in files)
    return f"{len(files)} kernels for {processor}, {size / 1e6:.1f} MB, in {places}; {seconds:.0f} s"
