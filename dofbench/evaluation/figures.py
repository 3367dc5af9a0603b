"""Helpers for all figures: colours, deterministic files, file names."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from dofbench.core.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's palette, which can be distinguished with every kind of colour blindness (without yellow: too pale
# on white). Line styles change too, for grey prints and for more than seven methods.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", "--", "-.", ":")
LOOKS = len(COLOURS) * len(STYLES)
NEUTRAL = "#767676"
DPI = 150

_FIXED: dict[Any, Any] = {
    "svg.hashsalt": "dofbench",
    "svg.fonttype": "path",
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
}


class Look(TypedDict):
    """How a line of a plot is drawn, as matplotlib takes it."""

    color: str
    linestyle: str


def look(place: int) -> Look:
    """Colour and line style of the line number `place`; after `LOOKS` lines they repeat."""
    return {"color": COLOURS[place % len(COLOURS)], "linestyle": STYLES[place // len(COLOURS) % len(STYLES)]}


def file_name(*parts: str) -> str:
    """A file name of these parts that is valid on every file system and needs no escaping in a Markdown link."""
    return "-".join(re.sub(r"[^A-Za-z0-9._@-]+", "_", part) for part in parts)


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the suffix says; the same figure gives the same bytes."""
    import matplotlib

    undated = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    with matplotlib.rc_context(_FIXED), replacing(path) as temporary:
        figure.savefig(temporary, dpi=DPI, metadata=undated)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure; width, height: inches. Made without pyplot, which keeps figures in memory and needs a
    display."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_FIXED):
        return Figure(figsize=(width, height), layout="constrained")
