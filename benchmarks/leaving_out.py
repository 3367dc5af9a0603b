"""How much time is saved by leaving out stages, and what it costs in quality: leaving-out.md and leaving-out.csv.

    python benchmarks/leaving_out.py DATASET... --out reports/leaving-out [--seeds 3] [--budget 1000it]

Every dataset is used twice, with its shallow photographs and with its sharp ones. If the plan leaves out a stage that
no earlier row has, the method is trained as planned and with --force-all, with the same seeds; if the plan leaves out
nothing, the table says why. Compared are processor seconds, which other work on the machine changes least.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass, replace
from pathlib import Path

import tyro
from rich.console import Console

from dofbench.compute.threads import configure_threads
from dofbench.core.budget import parse_budget
from dofbench.core.files import write_text
from dofbench.reporting.csv_writer import write_csv
from dofbench.results.result import Result, read_result
from dofbench.results.run_spec import Run
from dofbench.running.one_run import run
from dofbench.running.prepare import plan_run

SCORES = ("train_cpu_s", "train_s", "aif_psnr", "aif_ssim", "psnr", "delta_a", "delta_f", "delta_r")
COLUMNS = ("dataset", "inputs", "left_out", "reason", "forced", "seed", *SCORES)
INPUTS = ("shallow", "all-in-focus")


@dataclass(frozen=True)
class Settings:
    """What to train, and where the table goes."""

    data: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets."""
    out: Path
    """Folder for the table."""
    results: Path = Path("results")
    """Folder of results; runs that are finished there aren't repeated."""
    method: str = "dofgaussian"
    """Method."""
    preset: str | None = None
    """Preset; default: the method's."""
    set: tuple[str, ...] = ()
    """Options of every run."""
    budget: str = "1000it"
    """Budget of every run."""
    seeds: int = 3
    """Seeds, from 0."""


def main(settings: Settings) -> None:
    """Carry out the runs that aren't finished and write the table."""
    configure_threads()
    rows, lines, measured = [], [], set()
    for data in settings.data:
        for inputs in INPUTS:
            some, line = _compared(settings, data, inputs, measured)
            rows += some
            lines.append(line)
    settings.out.mkdir(parents=True, exist_ok=True)
    write_csv(settings.out / "leaving-out.csv", COLUMNS, rows)
    head = (
        "| dataset | photographs | left out | because | training, planned [CPU s] | forced [CPU s] | saved | "
        "all-in-focus PSNR, planned [dB] | forced [dB] | refocus PSNR, planned [dB] | forced [dB] |"
    )
    rule = "| :--- | :--- | :--- | :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
    write_text(settings.out / "leaving-out.md", "\n".join([head, rule, *lines]) + "\n")


def _compared(settings: Settings, data: Path, inputs: str, measured: set[str]) -> tuple[list[dict], str]:
    """CSV rows and a line of the table for one dataset; the left-out stages are added to `measured`."""
    call = Run(
        method=settings.method,
        data=data,
        preset=settings.preset,
        set=settings.set,
        budget=parse_budget(settings.budget),
        out=settings.results,
        inputs=inputs,
    )
    planned = plan_run(call, data)
    plan, dataset = planned.plan, planned.spec.dataset
    needless = {stage.name: stage.reason for stage in plan.stages if not stage.runs}
    if not needless:
        reasons = "; ".join(f"{stage.name}: {stage.reason}" for stage in plan.stages)
        return [], f"| {dataset} | {inputs} | nothing | {reasons} |" + " – |" * 7
    reasons = "; ".join(needless.values())
    if measured >= needless.keys():
        return [], f"| {dataset} | {inputs} | {', '.join(needless)} | {reasons} |" + " as above |" * 7
    measured.update(needless)
    rows, found = [], {False: [], True: []}
    for seed in range(settings.seeds):
        for forced in (False, True):
            result = _trained(call, seed, forced)
            found[forced].append(result)
            rows.append(
                {
                    "dataset": dataset,
                    "inputs": inputs,
                    "left_out": ", ".join(needless),
                    "reason": "; ".join(needless.values()),
                    "forced": forced,
                    "seed": seed,
                    **{score: result.scores.get(score) for score in SCORES},
                }
            )
    as_planned, forced = (
        statistics.median(result.scores["train_cpu_s"] for result in found[key]) for key in (False, True)
    )
    cells = [f"{as_planned:.0f}", f"{forced:.0f}", f"{1 - as_planned / forced:.0%}"]
    cells += [_spread(found[key], score) for score in ("aif_psnr", "psnr") for key in (False, True)]
    return rows, f"| {dataset} | {inputs} | {', '.join(needless)} | {reasons} | " + " | ".join(cells) + " |"


def _trained(call: Run, seed: int, forced: bool) -> Result:
    end = run(replace(call, seed=seed, force_all=forced), Console(quiet=True))
    if not end:
        raise SystemExit(f"{end.folder}: {end.status}")
    return read_result(end.folder)


def _spread(results: list[Result], score: str) -> str:
    values = [result.scores[score] for result in results if score in result.scores]
    if not values:
        return "–"
    return f"{statistics.fmean(values):.2f} ± {statistics.stdev(values) if len(values) > 1 else 0:.2f}"


if __name__ == "__main__":
    main(tyro.cli(Settings))
