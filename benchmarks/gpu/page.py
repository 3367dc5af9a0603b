"""The page of what `measure.py` measured, measured.md, and its numbers as a table, measured.csv."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from dofbench.core.markdown_text import markdown_table

COLUMNS = ("part", "name", "value")


def numbers(part: str, found: Any, name: str = "") -> Iterator[dict[str, Any]]:
    """The rows of measured.csv: every number of a part, by its place there."""
    if isinstance(found, dict):
        for key, value in found.items():
            yield from numbers(part, value, f"{name} / {key}" if name else key)
    elif isinstance(found, list):
        for place, value in enumerate(found):
            yield from numbers(part, value, f"{name} / {place}")
    elif isinstance(found, int | float):
        yield dict(zip(COLUMNS, (part, name, found), strict=True))


def floors(parts: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Of every op the time, ms, of reading and writing its tensors once, at the bandwidth that was measured."""
    if "machine" not in parts or "ops" not in parts:
        return {}
    rate = 1e6 * parts["machine"]["copy_gb_per_s"]
    return {
        op: {what: one[f"{what}_bytes"] / rate for what in ("forward", "both") if f"{what}_bytes" in one}
        for op, one in _ops(parts["ops"])
    }


def page(found: dict[str, Any]) -> str:
    """Markdown of everything in gpu.json; what is missing is said."""
    parts = found["parts"]
    commit = (found.get("commit") or {}).get("commit", "unknown")
    lines = [
        "# What a GPU measured",
        "",
        f"On {found['gpu']}, commit {commit}, by `python -m benchmarks.gpu.measure`.",
        "",
    ]
    for name, problem in found.get("failed", {}).items():
        lines += [f"**{name} failed**: {problem}", ""]
    if "machine" in parts:
        one = parts["machine"]
        lines += [
            f"{one['memory_gb']:.0f} GB of memory, copied at {one['copy_gb_per_s']:.0f} GB/s; {one['nvidia_smi']}.",
            "",
        ]
    if "agreement" in parts:
        keys = ("value", "value_share", "gradient", "gradient_share", "repeats")
        rows = [(op, *(_number(one.get(key)) for key in keys)) for op, one in _ops(parts["agreement"])]
        lines += [
            "## Beside the CPU backend",
            "",
            "Largest difference over the largest magnitude; the share of values that differ by more than 1e-5 of it; 1 "
            "where a second call gives the same bits. gsplat, where it is installed, is compared with this project's "
            "rasteriser on the GPU: colour and opacity.",
            "",
        ]
        lines += [*markdown_table(("op", "value", "share", "gradient", "share", "same bits"), rows, 1), ""]
    if "ops" in parts:
        least = floors(parts)
        lines += [
            "## Ops",
            "",
            "The time of a call that waits for its end; how long the GPU works on it; and the floor, which is reading "
            "and writing the op's tensors once.",
            "",
        ]
        each = ("works [ms]", "floor [ms]")
        head = ("op", "forward [ms]", *each, "with its gradient [ms]", *each)
        lines += [*markdown_table(head, [_times(op, one, least.get(op, {})) for op, one in _ops(parts["ops"])], 1), ""]
    if "cost" in parts:
        lines += ["## What it costs", ""]
        rows = [
            (what, value, *(_number(one.get(key)) for key in ("forward_ms", "both_ms", "peak_mb")))
            for what, values in parts["cost"].items()
            if isinstance(values, dict)
            for value, one in values.items()
        ]
        lines += [*markdown_table(("varied", "", "forward [ms]", "with its gradient [ms]", "memory [MB]"), rows, 1), ""]
    for name, one in parts.items():
        if name.startswith("step ") and "step_ms" in one:
            lines += [f"## A step on {name.removeprefix('step ')}", "", *_step(one), ""]
    trained = {name: one for name, one in parts.items() if name.startswith("training ")}
    if trained:
        keys = ("psnr", "aif_psnr", "delta_a", "delta_f", "train_s", "gaussians", "peak_mb", "fps", "fps_lens")
        head = ("dataset and steps", "status", *keys)
        rows = [
            (
                name.removeprefix("training "),
                one.get("status") or one.get("left_out", ""),
                *map(_number, map(one.get, keys)),
            )
            for name, one in trained.items()
        ]
        lines += ["## Training", "", *markdown_table(head, rows, 2), ""]
    return "\n".join(lines)


def _ops(part: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [(name, one) for name, one in part.items() if isinstance(one, dict)]


def _step(one: dict[str, Any]) -> list[str]:
    busy, step = one["gpu_ms"], one["step_ms"]
    lines = [
        f"{step:.3g} ms, the longest {one['longest_ms']:.3g}, with {one['gaussians']} Gaussians; the GPU works "
        f"{busy:.3g} ms of them, "
        f"in {one['launches']:.0f} launches.",
        "",
    ]
    for what, title in (("kernels", "on the GPU"), ("host", "by the host")):
        rows = [(f"`{name[:80]}`", _number(took), _number(times)) for name, (took, times) in one[what].items()]
        lines += [*markdown_table((title, "ms a step", "times a step"), rows[:20], 1), ""]
    return lines


def _times(op: str, one: dict[str, Any], floor: dict[str, float]) -> tuple[str, ...]:
    if "left_out" in one:
        return op, one["left_out"], *[""] * 5
    cells = []
    for what in ("forward", "both"):
        cells += [one.get(f"{what}_ms"), one.get(f"{what}_busy_ms"), floor.get(what)]
    return op, *map(_number, cells)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
