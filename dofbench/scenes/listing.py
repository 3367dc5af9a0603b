"""What `dofbench scenes` prints: the scenes that are here and can be read."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dofbench.content import content_folder
from dofbench.errors import InputError
from dofbench.scenes.loading import LAYOUTS, load_scene


@dataclass(frozen=True)
class Listed:
    """One line of the list. problem: why the scene can't be read, empty where it can.

    name: what to give to make-dataset: a built-in name or a folder. width, height: of the first view, pixels.
    title: what a built-in scene shows.
    """

    name: str
    layout: str = ""
    training: int = 0
    test: int = 0
    width: int = 0
    height: int = 0
    points: int = 0
    depth: bool = False
    title: str = ""
    problem: str = ""


def list_scenes(folders: Sequence[Path] = ()) -> list[Listed]:
    """The built-in scenes, then every folder given: itself where it is a scene, else the scenes right inside it.

    A given folder with no scene in it is listed with the reason; beside scenes, other folders are
    passed over. Raises InputError for a folder that isn't there.
    """
    listed = _built_in()
    for folder in folders:
        if not folder.is_dir():
            raise InputError(folder, "no such folder", "a scene, or a folder of scenes")
        itself = _describe(folder, str(folder))
        inside = [_describe(path, str(path)) for path in _folders(folder)]
        readable = [scene for scene in inside if not scene.problem]
        listed += [itself] if not itself.problem or not readable else readable
    return listed


def print_scenes(folders: Sequence[Path] = ()) -> bool:
    """Print `list_scenes` as a table, and what can't be read. False when there is any of that."""
    listed = list_scenes(folders)
    rows = [("scene", "layout", "views", "size", "points", "depth", "what")]
    rows += [
        (
            scene.name, scene.layout, f"{scene.training} + {scene.test} test", f"{scene.width}x{scene.height}",
            str(scene.points), "given" if scene.depth else "-", scene.title,
        )
        for scene in listed if not scene.problem
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    for scene in listed:
        if scene.problem:
            print(f"no scene: {scene.problem}")
    print(f"\nA scene is a built-in name or a folder in one of the layouts {', '.join(LAYOUTS)}.")
    return not any(scene.problem for scene in listed)


def _built_in() -> list[Listed]:
    root = content_folder("datasets")
    entries = [tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(root.glob("*.toml"))]
    return [replace(_describe(root / entry["folder"], entry["id"]), title=entry["title"]) for entry in entries]


def _folders(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir() and not path.name.startswith((".", "__")))


def _describe(folder: Path, name: str) -> Listed:
    try:
        scene = load_scene(folder)
    except InputError as error:
        return Listed(name, problem=str(error))
    first = scene.views[0]
    return Listed(
        name=name, layout=scene.layout, training=_count(scene.views, "train"), test=_count(scene.views, "test"),
        width=first.camera.width, height=first.camera.height,
        points=0 if scene.points is None else len(scene.points), depth=first.depth is not None,
    )


def _count(views: Iterable, split: str) -> int:
    return sum(view.split == split for view in views)
