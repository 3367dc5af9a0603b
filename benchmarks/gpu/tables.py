"""The CSVs of what `measure.py` measured: each row belongs to a GPU, and rows of other GPUs stay."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dofbench.core.files import write_csv

Row = dict[str, Any]
SCORES = ("psnr", "aif_psnr", "delta_a", "delta_f", "train_s", "gaussians")
LISTED = 12  # kernels, and calls of the host, of a step
TABLES = {
    "machines": ("gpu", "commit", "memory_gb", "copy_gb_per_s", "nvidia_smi", "torch", "triton"),
    "ops": (
        "gpu", "op", "value", "value_share", "gradient", "gradient_share", "repeats", "forward_ms", "forward_busy_ms",
        "forward_floor_ms", "both_ms", "both_busy_ms", "both_floor_ms", "left_out",
    ),
    "cost": ("gpu", "varied", "size", "forward_ms", "both_ms", "peak_mb", "left_out"),
    "steps": ("gpu", "dataset", "gaussians", "step_ms", "longest_ms", "gpu_ms", "launches", "left_out"),
    "step-parts": ("gpu", "dataset", "by", "name", "ms", "times"),
    "trainings": (
        "gpu", "dataset", "steps", "status", *SCORES, "trials_s", "peak_mb", "fps", "fps_lens", "message", "left_out",
    ),
    "failed": ("gpu", "part", "problem"),
}  # fmt: skip


def write_tables(folder: Path, found: dict[str, Any]) -> None:
    """Replace the rows of one GPU in the CSVs of a folder. found: the parts that were measured, as in gpu.json."""
    for table, columns in TABLES.items():
        file = folder / f"{table}.csv"
        rows = list(csv.DictReader(file.open(encoding="utf-8"))) if file.is_file() else []
        rows = [row for row in rows if row["gpu"] != found["gpu"]]
        rows += [{"gpu": found["gpu"], **row} for row in _rows(table, found)]
        if rows or file.is_file():
            write_csv(file, columns, rows)


def _rows(table: str, found: dict[str, Any]) -> Iterator[Row]:
    parts = found["parts"]
    if table == "machines" and "machine" in parts:
        machine, packages = parts["machine"], parts["machine"]["packages"]
        commit = (found.get("commit") or {}).get("commit")
        yield {**machine, "commit": commit, "torch": packages.get("torch"), "triton": packages.get("triton")}
    elif table == "ops":
        times, agreement = (_each(parts.get(part, {})) for part in ("ops", "agreement"))
        rate = 1e6 * parts["machine"]["copy_gb_per_s"] if "machine" in parts else None
        for op in {**times, **agreement}:
            row = {"op": op, **times.get(op, {}), **agreement.get(op, {})}
            if rate:  # the floor: reading and writing the op's tensors once
                row |= {f"{k}_floor_ms": row[f"{k}_bytes"] / rate for k in ("forward", "both") if f"{k}_bytes" in row}
            yield row
    elif table == "cost":
        for varied, sizes in _each(parts.get("cost", {})).items():
            yield from ({**one, "varied": varied, "size": size} for size, one in sizes.items())
    elif table == "failed":
        yield from ({"part": part, "problem": problem} for part, problem in found.get("failed", {}).items())
    else:
        for name, one in parts.items():
            kind, *words = name.split(" ")
            if table == "steps" and kind == "step":
                yield {"dataset": words[0], **one}
            elif table == "step-parts" and kind == "step" and "step_ms" in one:
                for by in ("kernels", "host"):
                    for part, (took, times) in list(one[by].items())[:LISTED]:
                        yield {"dataset": words[0], "by": by, "name": part[:80], "ms": took, "times": times}
            elif table == "trainings" and kind == "training":
                yield {"dataset": words[0], "steps": words[1], **one, "trials_s": one.get("stages", {}).get("trials")}


def _each(part: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The entries of a part that are tables themselves; the others are its seconds."""
    return {name: one for name, one in part.items() if isinstance(one, dict)}
