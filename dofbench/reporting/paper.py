"""The figures printed in the paper, by table layout; they are kept apart from scores measured here."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any

from dofbench.core.content import content_folder
from dofbench.evaluation.results.protocol import AIF_PREFIX
from dofbench.running.ablation_tables import of_scene

_OF_THEIR_SSIM = (
    " The paper's SSIM has a uniform window of 7 pixels (by the script that its authors released), SSIM here a "
    "Gaussian one of 11: compare the paper's with the column SSIM, uniform window 7, alone, which "
    "`dofbench score --metrics ssim_uniform7,aif_ssim_uniform7` adds to older results."
)


def ssim_note(columns: Iterable[str]) -> str:
    """A sentence on the paper's SSIM, wherever a table's columns from the paper have it."""
    return _OF_THEIR_SSIM if any(column.removeprefix(AIF_PREFIX) == "ssim_uniform7" for column in columns) else ""


@dataclass(frozen=True)
class Figures:
    """One printed table. means: method -> score -> value; scenes: the same by scene."""

    source: str
    data: str
    columns: tuple[str, ...]
    means: dict[str, dict[str, float]]
    scenes: dict[str, dict[str, dict[str, float]]]

    def of_scene(self, scene: str) -> dict[str, dict[str, float]]:
        """The paper's figures for the scene that a dataset was made from, method -> score -> value."""
        return of_scene(self.scenes, scene)


# For a layout without a table in the paper.
NOTHING_PRINTED = Figures("", "", (), {}, {})


@cache
def paper_figures() -> dict[str, Figures]:
    """Layout -> the paper's figures."""
    data = tomllib.loads((content_folder("reports/templates") / "paper.toml").read_text(encoding="utf-8"))
    source = data.pop("source")
    return {layout: _figures(source, table) for layout, table in data.items()}


def _figures(source: str, table: dict[str, Any]) -> Figures:
    columns = tuple(table["columns"])
    scenes = {
        scene: {method: _by_column(columns, values) for method, values in methods.items()}
        for scene, methods in table.get("scenes", {}).items()
    }
    means = {method: _by_column(columns, values) for method, values in table.get("means", {}).items()}
    return Figures(f"{source}, {table['table']}", table["data"], columns, means or _means(columns, scenes), scenes)


def _by_column(columns: tuple[str, ...], values: list[float]) -> dict[str, float]:
    return {column: float(value) for column, value in zip(columns, values, strict=True) if math.isfinite(value)}


def _means(columns: tuple[str, ...], scenes: dict[str, dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Means over all scenes, for the methods that have a value for every scene."""
    methods = dict.fromkeys(method for found in scenes.values() for method in found)
    return {
        method: {
            column: math.fsum(found[method][column] for found in scenes.values()) / len(scenes) for column in columns
        }
        for method in methods
        if all(method in found for found in scenes.values())
    }
