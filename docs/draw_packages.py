"""Draws the packages of dofbench and the imports between them into docs/packages.svg, for docs/architecture.md.

    python docs/draw_packages.py [CHECKOUT PICTURE]

The order is that of pyproject.toml; the arrows are the imports in the sources. Arrows that follow from others are left
out: if a imports b and c, and b imports c, there is no arrow from a to c. A test compares the file with the script's
output.

Of a CHECKOUT that declares no order, packages stand in the order with the fewest imports upward that is easily found;
imports upward are drawn in red, and modules that lie in no package are one box.
"""

from __future__ import annotations

import sys
import tomllib
from html import escape
from itertools import pairwise
from math import fsum
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "packages.svg"
sys.path.insert(0, str(ROOT / "tests"))

from import_walk import arrows, modules, package_of  # noqa: E402 - its folder has to be on the path first

BOX, ROW, GAP = (118, 34), 70, 22  # pixels: size of a box, distance between rows, gap between boxes
LANE = 12  # pixels: width of an arrow that passes a row
LOOSE = "(no package)"
COLOURS = {"down": "#99a", "up": "#c22"}

# A box's place in a row, or that of an arrow, (from, to, row), where it passes the row.
Node = str | tuple[str, str, int]


def packages(root: Path) -> dict[str, set[str]]:
    """Package -> packages that it imports from, in the declared order, or in one with few imports upward."""
    declared = tomllib.loads((root / "pyproject.toml").read_text()).get("tool", {}).get("dofbench", {}).get("packages")
    known = modules(root)
    loose = {} if declared else {name: LOOSE for name, file in known.items() if _is_loose(root, file)}
    names = declared or sorted({loose.get(name, package_of(name)) for name in known} - {""})
    below: dict[str, set[str]] = {name: set() for name in names}
    for module, target in arrows(known):
        here, there = (loose.get(one, package_of(one)) for one in (module, target))
        if here in below and there in below and here != there:
            below[here].add(there)
    return below if declared else {name: below[name] for name in from_the_ground_up(below)}


def _is_loose(root: Path, file: Path) -> bool:
    return file.parent == root / "dofbench" and file.stem not in ("__init__", "__main__", "cli")


def from_the_ground_up(below: dict[str, set[str]]) -> list[str]:
    """An order with few imports upward (Eades, Lin and Smyth, 1993: a fast heuristic for the feedback arc set)."""
    rest, first, last = dict(below), [], []
    while rest:
        above = {name: sum(name in rest[other] for other in rest) for name in rest}
        beneath = {name: len(rest[name] & rest.keys()) for name in rest}
        if sinks := [name for name in rest if not beneath[name]]:
            first.append(sinks[0])
        elif sources := [name for name in rest if not above[name]]:
            last.append(sources[0])
        else:
            first.append(max(rest, key=lambda name, above=above, beneath=beneath: above[name] - beneath[name]))
        del rest[(last if last and last[-1] in rest else first)[-1]]
    return [*first, *reversed(last)]


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
    """Rows from the ground up: a package stands one above the highest that it imports from and that precedes it."""
    height: dict[str, int] = {}
    for name in below:
        height[name] = 1 + max((height[there] for there in below[name] if there in height), default=-1)
    return [[name for name in below if height[name] == row] for row in range(max(height.values()) + 1)]


def way(name: str, other: str, height: dict[str, int]) -> list[Node]:
    """The nodes of an arrow, from its package down (or up) to the one that it imports from."""
    step = -1 if height[other] < height[name] else 1
    between: list[Node] = [(name, other, row) for row in range(height[name] + step, height[other], step)]
    return [name, *between, other]


def places(rows: list[list[str]], drawn: dict[str, set[str]]) -> dict[Node, float]:
    """The middle of each node along its row, pixels: near the nodes that its arrows lead to, so that few arrows cross,
    and with room for each box and each arrow that passes a row."""
    height = {name: index for index, row in enumerate(rows) for name in row}
    beside: dict[Node, list[Node]] = {}
    lanes: list[list[Node]] = [list(row) for row in rows]
    for name, others in drawn.items():
        for other in sorted(others):
            nodes = way(name, other, height)
            for node in nodes[1:-1]:
                assert isinstance(node, tuple)
                lanes[node[2]].append(node)
            for one, two in pairwise(nodes):
                beside.setdefault(one, []).append(two)
                beside.setdefault(two, []).append(one)
    place: dict[Node, float] = {}
    for lane in lanes:
        place |= {node: 100.0 * (index - len(lane) / 2) for index, node in enumerate(lane)}
    row_of = {node: index for index, lane in enumerate(lanes) for node in lane}
    for sweep in range(40):
        up = sweep % 2 == 0
        for index in range(len(lanes)) if up else range(len(lanes) - 1, -1, -1):
            lane = lanes[index]
            # Ordered by the neighbours in the row that comes before, placed by those in both.
            before = {
                node: [place[to] for to in beside.get(node, ()) if (row_of[to] < index) == up] or [place[node]]
                for node in lane
            }
            if sweep < 24:
                lane.sort(key=lambda node, before=before: fsum(before[node]) / len(before[node]))
            wanted = [
                fsum(place[to] for to in beside[node]) / len(beside[node]) if node in beside else place[node]
                for node in lane
            ]
            place |= dict(zip(lane, apart(wanted, [_width(node) for node in lane]), strict=True))
    return place


def _width(node: Node) -> float:
    return LANE if isinstance(node, tuple) else BOX[0] + GAP


def apart(wanted: list[float], widths: list[float]) -> list[float]:
    """Places in this order, as near to the wanted ones as their widths allow (least squares, by pooling neighbours)."""
    offsets = [0.0]
    for one, two in pairwise(widths):
        offsets.append(offsets[-1] + (one + two) / 2)
    pools: list[tuple[float, int]] = []  # mean and number of the places that touch
    for value in (want - offset for want, offset in zip(wanted, offsets, strict=True)):
        mean, count = value, 1
        while pools and pools[-1][0] > mean:
            other, more = pools.pop()
            mean, count = (mean * count + other * more) / (count + more), count + more
        pools.append((mean, count))
    pooled = [mean for mean, count in pools for _ in range(count)]
    return [value + offset for value, offset in zip(pooled, offsets, strict=True)]


def lines_of(root: Path) -> dict[str, int]:
    """Package -> lines of its Python sources, content folders behind a bridge included."""
    counts: dict[str, int] = {}
    for module, file in modules(root).items():
        name = package_of(module)
        counts[name] = counts.get(name, 0) + len(file.read_text().splitlines())
    return counts


def svg(below: dict[str, set[str]]) -> str:
    """The picture."""
    order = {name: index for index, name in enumerate(below)}
    upward = {name: {other for other in others if order[other] > order[name]} for name, others in below.items()}
    downward = {name: others - upward[name] for name, others in below.items()}
    drawn = {name: others | upward[name] for name, others in reduced(downward).items()}
    rows = levels(downward)
    height_of = {name: index for index, row in enumerate(rows) for name in row}
    place = places(rows, drawn)
    left = min(place[node] - _width(node) / 2 for node in place)
    width = max(place[node] + _width(node) / 2 for node in place) - left + GAP
    height = len(rows) * ROW + 10

    def at(node: Node, row: int) -> tuple[float, float]:
        return place[node] - left + GAP / 2, height - 10 - row * ROW - BOX[1] / 2

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height}" width="{width:g}" '
        f'height="{height}" font-family="sans-serif" font-size="13">',
        "<title>The packages of dofbench and what they import from</title>",
        *(
            f'<defs><marker id="{kind}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            f'orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="{colour}"/></marker></defs>'
            for kind, colour in COLOURS.items()
        ),
        f'<rect width="{width:g}" height="{height}" fill="#fff"/>',
    ]
    for name, others in drawn.items():
        for other in sorted(others):
            nodes = way(name, other, height_of)
            kind = "up" if other in upward[name] else "down"
            points = [at(node, node[2] if isinstance(node, tuple) else height_of[node]) for node in nodes]
            parts.append(
                f'<path d="{_curve(points)}" fill="none" stroke="{COLOURS[kind]}" stroke-width="1.2" '
                f'marker-end="url(#{kind})"/>'
            )
    for name, row in height_of.items():
        x, y = at(name, row)
        parts.append(
            f'<rect x="{x - BOX[0] / 2:.1f}" y="{y - BOX[1] / 2:.1f}" width="{BOX[0]}" height="{BOX[1]}" rx="5" '
            'fill="#eef3fa" stroke="#345"/>'
            f'<text x="{x:.1f}" y="{y + 5:.1f}" text-anchor="middle">{escape(name)}</text>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _curve(points: list[tuple[float, float]]) -> str:
    """Straight down beside each row that an arrow passes, and bent between two rows."""
    half = BOX[1] / 2
    down = points[-1][1] > points[0][1]
    out, into = (half, -half) if down else (-half, half)
    if abs(points[-1][1] - points[0][1]) < 1:  # both in one row: an arch above it
        (x, y), (to_x, to_y) = points
        return f"M{x:.1f} {y - half:.1f} C{x:.1f} {y - 34:.1f} {to_x:.1f} {to_y - 34:.1f} {to_x:.1f} {to_y - half:.1f}"
    x, y = points[0]
    text = f"M{x:.1f} {y + out:.1f}"
    for (x, y), (to_x, to_y) in pairwise(points):
        start, end = y + out, to_y + into
        middle = (start + end) / 2
        text += f" C{x:.1f} {middle:.1f} {to_x:.1f} {middle:.1f} {to_x:.1f} {end:.1f}"
        if (to_x, to_y) != points[-1]:
            text += f" L{to_x:.1f} {to_y + out:.1f}"
    return text


if __name__ == "__main__":
    if len(sys.argv) == 3:
        ROOT, PICTURE = Path(sys.argv[1]), Path(sys.argv[2])
    PICTURE.write_text(svg(packages(ROOT)))
    print(PICTURE)
    for package, count in lines_of(ROOT).items():
        if package:
            print(f"{package:12} {count:6} lines")
