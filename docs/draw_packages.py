"""Draws the packages of dofbench and the imports between them into docs/packages.svg, for docs/architecture.md.

    python docs/draw_packages.py

The order is that of pyproject.toml; the arrows are the imports in the sources. Arrows that follow from others are left
out: if a imports b and c, and b imports c, there is no arrow from a to c. A test compares the file with the script's
output.
"""

from __future__ import annotations

import sys
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "packages.svg"
sys.path.insert(0, str(ROOT / "tests"))

from import_walk import arrows, modules, package_of  # noqa: E402 - its folder has to be on the path first

BOX, ROW, GAP = (118, 34), 78, 22  # pixels: size of a box, distance between rows, gap between boxes


def packages(root: Path) -> dict[str, set[str]]:
    """Package -> packages that it imports from, in the declared order."""
    order = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["dofbench"]["packages"]
    below: dict[str, set[str]] = {name: set() for name in order}
    for module, target in arrows(modules(root)):
        here, there = package_of(module), package_of(target)
        if here in below and there in below and here != there:
            below[here].add(there)
    return below


def reached(below: dict[str, set[str]], start: str) -> set[str]:
    """All packages that a package imports from, directly or indirectly."""
    found: set[str] = set()
    waiting = set(below[start])
    while waiting:
        name = waiting.pop()
        found.add(name)
        waiting |= below[name] - found
    return found


def reduced(below: dict[str, set[str]]) -> dict[str, set[str]]:
    """The imports without those that follow from others."""
    return {
        name: {there for there in direct if not any(there in reached(below, other) for other in direct - {there})}
        for name, direct in below.items()
    }


def levels(below: dict[str, set[str]]) -> list[list[str]]:
    """Rows from the ground up: a package stands one above the highest that it imports from."""
    height: dict[str, int] = {}
    for name in below:  # those that it imports from come before it
        height[name] = 1 + max((height[there] for there in below[name]), default=-1)
    return [[name for name in below if height[name] == row] for row in range(max(height.values()) + 1)]


def sorted_rows(rows: list[list[str]], arrows_drawn: dict[str, set[str]]) -> list[list[str]]:
    """Each row in the order of the mean place of what its packages import from, so that fewer arrows cross."""
    place: dict[str, float] = {}
    result = []
    for row in rows:
        middle = {
            name: sum(place[there] for there in arrows_drawn[name]) / max(len(arrows_drawn[name]), 1) for name in row
        }
        ordered = sorted(row, key=lambda name, middle=middle: (middle[name], name))
        place |= {name: index - (len(ordered) - 1) / 2 for index, name in enumerate(ordered)}
        result.append(ordered)
    return result


def lines_of(root: Path) -> dict[str, int]:
    """Package -> lines of its Python sources, content folders behind a bridge included."""
    counts: dict[str, int] = {}
    for module, file in modules(root).items():
        name = package_of(module)
        counts[name] = counts.get(name, 0) + len(file.read_text().splitlines())
    return counts


def svg(below: dict[str, set[str]]) -> str:
    """The picture."""
    drawn = reduced(below)
    rows = sorted_rows(levels(below), drawn)
    widest = max(len(row) for row in rows)
    width, height = widest * (BOX[0] + GAP) + GAP, len(rows) * ROW + 10
    corner = {}
    for index, row in enumerate(rows):
        left = (width - len(row) * (BOX[0] + GAP) + GAP) / 2
        for column, name in enumerate(row):
            corner[name] = (left + column * (BOX[0] + GAP), height - (index + 1) * ROW + ROW - BOX[1] - 10)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="sans-serif" font-size="13">',
        "<title>The packages of dofbench and what they import from</title>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 L8 4 L0 8 z" fill="#667"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
    ]
    for name, others in drawn.items():
        x, y = corner[name]
        for other in sorted(others):
            to_x, to_y = corner[other]
            parts.append(
                f'<path d="M{x + BOX[0] / 2:g} {y + BOX[1]:g} C{x + BOX[0] / 2:g} {y + BOX[1] + 25:g} '
                f'{to_x + BOX[0] / 2:g} {to_y - 25:g} {to_x + BOX[0] / 2:g} {to_y:g}" '
                'fill="none" stroke="#99a" stroke-width="1.2" marker-end="url(#tip)"/>'
            )
    for name, (x, y) in corner.items():
        parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{BOX[0]}" height="{BOX[1]}" rx="5" fill="#eef3fa" stroke="#345"/>'
            f'<text x="{x + BOX[0] / 2:g}" y="{y + BOX[1] / 2 + 5:g}" text-anchor="middle">{escape(name)}</text>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(svg(packages(ROOT)))
    print(PICTURE)
    for package, count in lines_of(ROOT).items():
        if package:
            print(f"{package:12} {count:6} lines")
