"""The options of `dofbench report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from dofbench.core.options import options


@options()
class Report:
    """Make leaderboards, curves and per-view tables of every result below a folder."""

    results: Annotated[Path, tyro.conf.Positional] = Path("results")
    """Folder of results, as `dofbench run` writes them."""
    out: Path = Path("reports/leaderboard")
    """Folder to write to."""
    pictures: bool = True
    """Show truths, predictions, errors and films; --no-pictures skips them, for example if the images may not be
    published."""
    reach: str = ""
    """Levels for the tables of time to reach a score, comma-separated: psnr=30,delta_f=0.01. For other scores, levels
    are chosen from the data."""
    against: str = ""
    """Methods that every other is compared with view by view, comma-separated: 3dgs,nerf. Default: up to eight are all
    compared with each other; of more, each with the best."""
    ablation: Path | None = None
    """Folder of tables written by `dofbench ablate`, to show in report.html."""
    merge: tuple[Path, ...] = ()
    """Further folders of results, from other machines. A run that is in several counts once."""
    refocus: Annotated[int, Field(ge=0)] = 24
    """Models to show at several focus distances. The frames are rendered once and kept next to the result; 0 renders
    none."""
    page_runs: Annotated[int, Field(ge=1)] = 500
    """Runs that one set of pages shows; of more, every dataset has pages of its own, in scenes/."""

    def __post_init__(self) -> None:
        self.levels  # noqa: B018 - raises InputError for a wrong level before any result is read

    @property
    def levels(self) -> dict[str, tuple[float, ...]]:
        """Score -> levels of `reach`."""
        if not self.reach:
            return {}
        # Imported here because it loads numpy, which the help doesn't need
        from dofbench.reporting.curves import parse_levels

        return parse_levels(self.reach)

    @property
    def rivals(self) -> tuple[str, ...]:
        """The methods of `against`."""
        return tuple(method.strip() for method in self.against.split(",") if method.strip())
