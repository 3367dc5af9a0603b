"""Time and memory of the stereo prior on a scene's photographs, compared with another checkout: a table for priors.md.

    python benchmarks/stereo_speed.py SCENES/shallow_blowtorch --width 504 --views 54 [--old CHECKOUT --repeats 3]

One process per checkout, with the same photographs. The two processes alternate, after a call on three views that
compiles.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

HERE = Path(__file__).resolve()


@dataclass(frozen=True)
class Settings:
    """What to time."""

    scene: tyro.conf.Positional[Path]
    """Scene folder."""
    width: int = 504
    """Width of the photographs, pixels."""
    views: int = 54
    """How many of the scene's views to use, evenly spaced."""
    old: Path | None = None
    """Another checkout, to compare with."""
    repeats: int = 3
    """Timed calls of each."""


def main(settings: Settings) -> None:
    """Print the table."""
    checkouts = {"this": HERE.parents[1], **({"other": settings.old} if settings.old else {})}
    workers = {name: _start(folder, settings) for name, folder in checkouts.items()}
    sizes = {name: _ask(worker) for name, worker in workers.items()}
    found = {name: [] for name in workers}
    for _ in range(settings.repeats):
        for name, worker in workers.items():
            found[name].append(_ask(worker))
    for worker in workers.values():
        worker.stdin.close()
        worker.wait()
    print(
        "| checkout | views | size | wall (s) | CPU (s) | pixels with depth | memory before | at its peak |\n"
        + "|---" * 8
        + "|"
    )
    for name, calls in found.items():
        middle = {key: statistics.median(call[key] for call in calls) for key in calls[0]}
        task = sizes[name]
        print(
            f"| {name} | {task['views']} | {task['size']} | {middle['wall']:.1f} | {middle['cpu']:.1f} |"
            f" {100 * middle['share']:.2f} % | {task['before']:.0f} MB | {middle['peak']:.0f} MB |"
        )
    if settings.old:
        for key in ("wall", "cpu"):
            ratios = [old[key] / new[key] for old, new in zip(found["other"], found["this"], strict=True)]
            print(f"{key}, other / this: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


def _start(checkout: Path, settings: Settings) -> subprocess.Popen:
    command = [sys.executable, str(HERE), "--worker", str(settings.scene), str(settings.width), str(settings.views)]
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
    )


def _ask(worker: subprocess.Popen) -> dict:
    worker.stdin.write("\n")
    worker.stdin.flush()
    line = worker.stdout.readline()
    if not line:
        raise RuntimeError("the other process ended before its answer")
    return json.loads(line)


def _work(scene: Path, width: int, count: int) -> None:
    """The worker process: answers the first line of input with the size of the task, and every further line with the
    cost of a call."""
    from dofbench.core.contracts import TrainingSet, TrainingView
    from dofbench.learning.priors.stereo import stereo_depth
    from dofbench.scenes import load_scene

    loaded = load_scene(scene, width=width)
    chosen = sorted(set(np.linspace(0, len(loaded.views) - 1, count).round().astype(int).tolist()))
    views = [loaded.views[index] for index in chosen]
    every = TrainingSet(
        tuple(TrainingView(view.name, view.camera, np.clip(view.image(), 0, 1).astype(np.float32)) for view in views),
        loaded.points.seen_by(chosen),
    )
    few = TrainingSet(every.views[:3], every.points.seen_by(range(3)))
    stereo_depth(few)
    height, width = every.views[0].image.shape[:2]
    answers = [{"views": len(views), "size": f"{width} x {height}", "before": _resident()}]
    for _ in sys.stdin:
        if answers:
            print(json.dumps(answers.pop()), flush=True)
            continue
        wall, cpu = time.perf_counter(), time.process_time()
        maps = stereo_depth(every)
        print(
            json.dumps(
                {
                    "wall": time.perf_counter() - wall,
                    "cpu": time.process_time() - cpu,
                    "share": float(np.mean([(one.depth > 0).mean() for one in maps])),
                    "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                }
            ),
            flush=True,
        )


def _resident() -> float:
    """Resident memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        _work(Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
    else:
        main(tyro.cli(Settings))
