"""Print the scenes that are here and whether they are complete (`dofbench scenes`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from dofbench.core.aligned import aligned
from dofbench.core.errors import InputError
from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.scenes.light_field.grid import LIGHT_FIELD, is_grid, read_grid
from dofbench.scenes.loading import LAYOUTS, load_scene
from dofbench.scenes.named import NamedDataset, find_data_root, named_datasets, scenes_of
from dofbench.scenes.named.places import VARIABLE, ResolvedScene, same_files, what_to_put
from dofbench.scenes.readers.folders import MissingImages, marked_hold
from dofbench.scenes.readers.poses import unchecked
from dofbench.scenes.scene import Scene, SceneView

# "here": readable, and there is no published checksum to compare with.
State = Literal["complete", "here", "incomplete", "different", "unreadable", "absent"]


@dataclass(frozen=True)
class Presence:
    """State of a scene. detail: one line; training, test: numbers of views, 0 where it can't be read."""

    scene: ResolvedScene
    state: State
    detail: str
    training: int = 0
    test: int = 0

    @property
    def is_problem(self) -> bool:
        """Whether something is here that isn't as it should be."""
        return self.state in ("incomplete", "different", "unreadable")


def inspect(scene: ResolvedScene) -> Presence:
    """Check a scene's files: readable, and the recorded number of views, size and checksums. Image headers are read,
    and no pixels."""
    if scene.missing:
        return Presence(scene, "absent", scene.missing)
    if scene.layout == "blb":
        return Presence(scene, "here", "single views for validate-renderer")
    try:
        seen = _describe_grid(scene.root, "") if scene.layout == LIGHT_FIELD else _described(scene.load(), "")
    except InputError as error:
        return Presence(scene, "unreadable", str(error))
    training, views, size = seen.training, seen.training + seen.test, (seen.width, seen.height)
    marked = marked_hold(scene.root)
    detail = f"{training} + {views - training} test, {size[0]}x{size[1]}"
    state: State = "here" if scene.views is None else "complete"
    if scene.views is not None and views != scene.views:
        state = "incomplete" if views < scene.views else "different"
        detail = f"{views} views in {scene.root}, expected {scene.views}"
    elif scene.size is not None and scene.size != size:
        state, detail = "different", f"{detail} in {scene.root}, expected {scene.size[0]}x{scene.size[1]}"
    elif scene.hold is not None and marked is not None and marked != scene.hold:
        state, detail = "different", f"a marker hold={marked} in {scene.root}, expected hold={scene.hold}"
    elif other := same_files(scene.root, scene.sha256):
        state, detail = "different", f"{scene.root / other} has another checksum than recorded"
    return Presence(scene, state, detail, training, views - training)


@dataclass(frozen=True)
class Listed:
    """One row of the list. problem: why the scene can't be read, empty where it can.

    name: argument of make-dataset. split: the rule or file that made it. width, height: of the first view, pixels.
    exif: how many f-numbers and focus distances are known. title: of a built-in scene. notes: of reading. whole: no
    image that it names is missing.
    """

    name: str
    layout: str = ""
    training: int = 0
    test: int = 0
    split: str = ""
    width: int = 0
    height: int = 0
    points: int = 0
    depth: bool = False
    exif: str = ""
    title: str = ""
    problem: str = ""
    notes: tuple[str, ...] = ()
    whole: bool = True


def list_scenes(folders: Sequence[Path] = ()) -> list[Listed]:
    """List the built-in scenes, then every given folder: itself where it is a scene, else the scenes right inside it.

    A folder without a scene is listed with the reason. Raises InputError for a folder that isn't there.
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


def print_scenes(folders: Sequence[Path] = (), data_root: Path | None = None) -> bool:
    """Print `list_scenes` and the named datasets as tables, and what can't be read or isn't complete.

    data_root: of named datasets; None for DOFBENCH_DATA's. False when anything can't be read or isn't complete; absent
    scenes are no failure. Raises InputError for a folder that isn't there.
    """
    root = find_data_root(data_root)
    listed = list_scenes(folders)
    rows = [("scene", "layout", "views", "split by", "size", "points", "depth", "EXIF", "what")]
    for scene in listed:
        if not scene.problem:
            views, size = f"{scene.training} + {scene.test} test", f"{scene.width}x{scene.height}"
            maps = str(scene.points), "given" if scene.depth else "-", scene.exif or "-"
            rows.append((scene.name, scene.layout, views, scene.split, size, *maps, scene.title))
    _print_table(rows)
    for scene in listed:
        for note in scene.notes:
            print(f"{scene.name}: {note}")
        if scene.problem:
            print(f"no scene: {scene.problem}")
    whole = _print_named(root)
    layouts = ", ".join([*LAYOUTS, LIGHT_FIELD])
    print(f"\nA scene is a built-in name, DATASET/SCENE or SCENE of a named one, or a folder in a layout of {layouts}.")
    return whole and all(scene.whole and not scene.problem for scene in listed)


def _print_named(root: Path | None) -> bool:
    """Print the named datasets; with a data root, what of them is in it. False when anything there isn't whole."""
    datasets = [dataset for dataset in named_datasets().values() if not dataset.built_in]
    found = {dataset.id: [inspect(scene) for scene in scenes_of(dataset, root)] for dataset in datasets}
    rows = [("dataset", "here", "of", "licence", "what")]
    for dataset in datasets:
        here = sum(presence.state != "absent" for presence in found[dataset.id])
        rows.append((dataset.id, str(here) if root else "-", _expected(dataset), dataset.licence, dataset.title))
    print()
    _print_table(rows)
    if root is None:
        print(f"\nWhich of their scenes are here: dofbench scenes --data-root DIR, or set {VARIABLE}.")
        return True
    for dataset in datasets:
        print(f"\n{dataset.id}: {dataset.title}")
        _print_presences(dataset, found[dataset.id], root)
    return not any(presence.is_problem for presences in found.values() for presence in presences)


def _expected(dataset: NamedDataset) -> str:
    if dataset.marker is None:
        return str(len(dataset.scenes))
    return "?" if dataset.expected is None else str(dataset.expected)


def _print_presences(dataset: NamedDataset, presences: Sequence[Presence], root: Path) -> None:
    """What is here, a line each; then, once for all that is absent, what to put where."""
    here = [(one.scene, one.state, one.detail) for one in presences if one.state != "absent"]
    rows = [(f"  {scene.label}", scene.role or ROLE_NOT_STATED, *found, scene.note) for scene, *found in here]
    _print_table(rows)
    absent = [presence.scene for presence in presences if presence.state == "absent"]
    if absent:
        print(f"  absent: {', '.join(scene.label.partition('/')[2] for scene in absent)}")
    if absent or not presences:
        for line in _places(dataset, {scene.label for scene in absent}, root):
            print(f"  put {line}")
    for left_out in dataset.left_out:
        print(f"  excluded: {left_out.scene}: {left_out.why}")


def _places(dataset: NamedDataset, absent: Set[str], root: Path) -> list[str]:
    """Where absent scenes go: by the dataset's pattern; else the first choice of each; or where other datasets say."""
    missing = [scene for scene in dataset.scenes if f"{dataset.id}/{scene.name}" in absent]
    others = dict.fromkeys(scene.of.partition("/")[0] for scene in missing if scene.of is not None)
    lines = [f"the scenes of {' and '.join(others)}, as said there"] if others else []
    if dataset.folders:
        lines.append(what_to_put(dataset, dataset.folders, root))
    elif own := [scene.folders[0] for scene in missing if scene.of is None]:
        lines.append(what_to_put(dataset, (", ".join(own),), root))
    return lines


def _print_table(rows: Sequence[Sequence[str]]) -> None:
    for line in aligned(rows):
        print(line)


def _built_in() -> list[Listed]:
    return [
        replace(_describe(scene.root, scene.label), title=dataset.title)
        for dataset in named_datasets().values()
        if dataset.built_in
        for scene in scenes_of(dataset, None)
        if not scene.missing
    ]


def _folders(parent: Path) -> list[Path]:
    return sorted(path for path in parent.iterdir() if path.is_dir() and not path.name.startswith((".", "__")))


def _describe(folder: Path, name: str) -> Listed:
    missing = ""
    try:
        if is_grid(folder):
            return _describe_grid(folder, name)
        try:
            scene = load_scene(folder)
        except MissingImages:
            scene = load_scene(folder, skip_missing=True)
            missing = "images are missing: make-dataset reads the others with --skip-missing"
    except InputError as error:
        return Listed(name, problem=str(error))
    listed = _described(scene, name)
    return replace(listed, notes=scene.noted(unchecked(scene), missing).notes, whole=not missing)


def _describe_grid(folder: Path, name: str) -> Listed:
    """A light field: views without poses and split, which make-dataset gives them."""
    grid = read_grid(folder)
    width, height = grid.size
    return Listed(name, LIGHT_FIELD, training=len(grid.files), split="make-dataset", width=width, height=height)


def _described(scene: Scene, name: str) -> Listed:
    first = scene.views[0]
    return Listed(
        name=name,
        layout=scene.layout,
        training=_count(scene.views, "train"),
        test=_count(scene.views, "test"),
        split=scene.split_by,
        width=first.camera.width,
        height=first.camera.height,
        points=0 if scene.points is None else len(scene.points),
        depth=first.depth is not None,
        exif=_exif_text(scene.views),
    )


def _exif_text(views: Sequence[SceneView]) -> str:
    """A text such as "20 f-numbers, 18 focus distances"; empty where none is known."""
    records = [view.exif for view in views if view.exif is not None]
    f_numbers = sum(record.f_number is not None for record in records)
    distances = sum(record.focus_distance is not None for record in records)
    counts = ((f_numbers, "f-number"), (distances, "focus distance"))
    return ", ".join(f"{count} {what}{'s' * (count != 1)}" for count, what in counts if count)


def _count(views: Iterable[SceneView], split: str) -> int:
    return sum(view.split == split for view in views)
