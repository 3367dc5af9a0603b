"""Meshes by formula: sheets, boxes, discs, turned bodies, ribbons, leaves, rods, ground."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from dofbench.scenes.procedural.stage import Mesh


def quad(
    corner: Sequence[float] | np.ndarray,
    right: Sequence[float] | np.ndarray,
    up: Sequence[float] | np.ndarray,
    repeat: tuple[float, float] = (1, 1),
) -> Mesh:
    """A flat parallelogram; `corner` is the texture's lower left. repeat: of the texture along `right` and `up`."""
    corner, right, up = (np.asarray(v, float) for v in (corner, right, up))
    vertices = np.stack([corner, corner + right, corner + right + up, corner + up])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float) * repeat
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv)


def box(x: float, y: float, size: Sequence[float], turn: float = 0.0, base: float = 0.0) -> Mesh:
    """A box of (width, depth, height) standing at (x, y), turned by `turn` degrees; each face has the whole texture."""
    w, d, h = size
    sides = [
        quad((-w / 2, -d / 2, 0), (w, 0, 0), (0, 0, h)),
        quad((w / 2, d / 2, 0), (-w, 0, 0), (0, 0, h)),
        quad((w / 2, -d / 2, 0), (0, d, 0), (0, 0, h)),
        quad((-w / 2, d / 2, 0), (0, -d, 0), (0, 0, h)),
        quad((-w / 2, -d / 2, h), (w, 0, 0), (0, d, 0)),
    ]
    whole = merged(sides)
    return Mesh(whole.vertices @ about_z(turn).T + (x, y, base), whole.faces, whole.uv)


def lid(x: float, y: float, z: float, radius: float, sides: int = 64) -> Mesh:
    """A horizontal disc that closes a cylinder."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([[[x, y, z]], np.column_stack([rim * radius + (x, y), np.full(sides, z)])])
    ring = np.arange(sides)
    faces = np.stack([np.zeros(sides, int), 1 + ring, 1 + (ring + 1) % sides], axis=1)
    return Mesh(vertices, faces, np.concatenate([[[0.5, 0.5]], 0.5 + 0.5 * rim]))


def blade(
    root: Sequence[float], lean: tuple[float, float], height: float, width: float, facing: float, steps: int = 14
) -> Mesh:
    """A grass blade: a ribbon that rises from `root`, bends by `lean` (x, y) at the tip and tapers to a point."""
    t = np.linspace(0, 1, steps + 1)[:, None]
    spine = np.asarray(root) + np.hstack([t**2 * lean[0], t**2 * lean[1], height * (t - 0.18 * t**3)])
    half = 0.5 * width * (1 - t**2.5) * np.array([[np.cos(facing), np.sin(facing), 0.0]])
    return _ribbon(spine, half, t)


def leaf(
    root: Sequence[float] | np.ndarray,
    along: Sequence[float] | np.ndarray,
    normal: Sequence[float] | np.ndarray,
    width: float,
    bend: float = 0.15,
    steps: int = 6,
) -> Mesh:
    """A leaf from `root` to root + along, widest in the middle, that bends away from `normal` towards its tip."""
    along, normal = np.asarray(along, float), np.asarray(normal, float)
    side = np.cross(along, normal)
    side /= np.linalg.norm(side)
    t = np.linspace(0, 1, steps + 1)[:, None]
    sag = bend * np.linalg.norm(along) * t**2 * normal / np.linalg.norm(normal)
    half = 0.5 * width * np.sin(np.pi * t**0.8) * side
    return _ribbon(np.asarray(root) + t * along - sag, half, t)


def turned(x: float, y: float, profile: Sequence[tuple[float, float]], base: float = 0.0, sides: int = 48) -> Mesh:
    """A body turned on a lathe at (x, y), hollow where its profile continues inside downwards.

    profile: (radius, height above `base`) of its outline, outside upwards. u goes round it, v along the profile.
    """
    outline = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    flat = (outline[:, None, :1] * rim + (x, y)).reshape(-1, 2)
    vertices = np.column_stack([flat, np.repeat(base + outline[:, 1], sides + 1)])
    steps = np.hypot(*np.diff(outline, axis=0).T)
    v = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    uv = np.stack([np.tile(angle / (2 * np.pi), len(outline)), np.repeat(v, sides + 1)], axis=1)
    corner = (np.arange(len(outline) - 1)[:, None] * (sides + 1) + np.arange(sides)).reshape(-1, 1)
    faces = np.concatenate([corner + (0, 1, sides + 2), corner + (0, sides + 2, sides + 1)])
    return Mesh(vertices, faces, uv)


def ground(x: np.ndarray, y: np.ndarray, height: Callable[[np.ndarray, np.ndarray], np.ndarray], repeat: float) -> Mesh:
    """Land over the grid of x and y. height: function of x and y. repeat: scene units per texture."""
    across, away = np.meshgrid(x, y)
    vertices = np.stack([across, away, height(across, away)], axis=-1).reshape(-1, 3)
    corner = (np.arange(len(y) - 1)[:, None] * len(x) + np.arange(len(x) - 1)).reshape(-1, 1)
    faces = np.concatenate([corner + (0, 1, len(x) + 1), corner + (0, len(x) + 1, len(x))])
    return Mesh(vertices, faces, vertices[:, :2] / repeat)


def merged(parts: Iterable[Mesh]) -> Mesh:
    """One mesh of several that share a texture."""
    parts = list(parts)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.uv for part in parts]),
    )


def rod(start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray, radius: float, sides: int = 8) -> Mesh:
    """A thin cylinder as a prism, so that hundreds of rods can be merged into one mesh."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    over = np.cross(axis, across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    rim = radius * (np.cos(angle) * across + np.sin(angle) * over)
    vertices = np.concatenate([start + rim, end + rim])
    corner = np.arange(sides)[:, None]
    faces = np.concatenate([corner + (0, 1, sides + 2), corner + (0, sides + 2, sides + 1)])
    u = np.linspace(0, 1, sides + 1)
    uv = np.concatenate([np.column_stack([u, np.zeros_like(u)]), np.column_stack([u, np.ones_like(u)])])
    return Mesh(vertices, faces, uv)


def about_z(degrees: float) -> np.ndarray:
    """(3, 3) rotation about the vertical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def sheet(x: float, y: float, width: float, depth: float, turn: float, lift: float) -> Mesh:
    """A flat sheet on the table, `lift` above it, so that the surfaces don't coincide."""
    right, up = about_z(turn) @ (width, 0, 0), about_z(turn) @ (0, depth, 0)
    return quad(np.array([x, y, lift]) - right / 2 - up / 2, right, up)


def _ribbon(spine: np.ndarray, half: np.ndarray, t: np.ndarray) -> Mesh:
    """spine, half: (N, 3) middle and half width along a ribbon; t: (N, 1), 0 at its root to 1."""
    vertices = np.stack([spine - half, spine + half], axis=1).reshape(-1, 3)
    row = 2 * np.arange(len(t) - 1)[:, None]
    faces = np.concatenate([row + (0, 1, 3), row + (0, 3, 2)])
    uv = np.stack([np.hstack([np.zeros_like(t), t]), np.hstack([np.ones_like(t), t])], axis=1).reshape(-1, 2)
    return Mesh(vertices, faces, uv)
