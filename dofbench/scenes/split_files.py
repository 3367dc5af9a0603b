"""Splits that files name: test.txt and train.txt, in the scene folder or beside its COLMAP model, and lists in JSON.

3DGS reads sparse/0/test.txt; Zip-NeRF and others read train.txt and test.txt; ScanNet++ has train_test_lists.json.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.core.readable import read_text
from dofbench.scenes.colmap_places import find_model
from dofbench.scenes.folders import image_files, listed
from dofbench.scenes.name_match import ImageNames, plain_inside
from dofbench.scenes.scene import Scene, Split

_JSON = ("split.json", "train_test_lists.json")
_LISTS = ("train", "test", "val")
_CURE = "; or give --hold N, by which such files aren't read"


@dataclass(frozen=True)
class FileSplit:
    """Names by list, as one file, or the files of one folder, give them. source: those files, for messages."""

    source: str
    file: Path
    names: Mapping[str, tuple[str, ...]]


def find_splits(root: Path) -> list[FileSplit]:
    """What the files of a scene folder say of its split. Raises InputError for files that can't be read."""
    model = find_model(root)
    folders = [root] if model is None else [root, model]
    found = [split for folder in folders if (split := _of_texts(root, folder)) is not None]
    return found + [_of_json(root, root / name) for name in _JSON if (root / name).is_file()]


def split_sources(root: Path) -> list[str]:
    """The files of a scene folder that name a split, relative to it."""
    model = find_model(root)
    texts = [folder / f"{part}.txt" for folder in (root, model) if folder is not None for part in ("train", "test")]
    return [file.relative_to(root).as_posix() for file in (*texts, *(root / name for name in _JSON)) if file.is_file()]


def split_by_files(scene: Scene, known_as: Mapping[Path, str], absent: Collection[str] = ()) -> Scene | None:
    """The scene split as its files say; None where there is no such file.

    known_as: what the images' files (`SceneView.source`) are called where their poses are, for files that have other
    names. absent: names of images that were skipped, which are no strangers. With one list of train and test, the
    other views are the other's; with both, views for validation alone (val) are dropped. Raises InputError for names
    that no image has, or several; views in two lists or none; and files that contradict each other.
    """
    found = find_splits(scene.root)
    return split_by(scene, found, known_as, absent) if found else None


def split_by(
    scene: Scene, found: Sequence[FileSplit], known_as: Mapping[Path, str], absent: Collection[str] = ()
) -> Scene:
    """As `split_by_files`, for the splits that are given, one at least."""
    splits = [_applied(split, scene, known_as, absent) for split in found]
    for split, other in zip(found[1:], splits[1:], strict=True):
        if other != splits[0]:
            differing = [view for view in splits[0] if splits[0][view] != other[view]]
            said = f"{listed(differing)} otherwise than {found[0].source}"
            raise InputError(split.file, f"a split that has {said}", f"one split{_CURE}")
    kept = [index for index, view in enumerate(scene.views) if splits[0][view.name] is not None]
    by = " and ".join(split.source for split in found)
    chosen = _with_splits(scene, splits[0], kept)
    dropped = len(scene.views) - len(kept)
    test = len(chosen.test_views())
    note = f"split by {by}: {len(kept) - test} training and {test} test views"
    return replace(chosen, split_by=by).noted(f"{note}, {dropped} for validation alone skipped" if dropped else note)


def agreed(scene: Scene, known_as: Mapping[Path, str], absent: Collection[str]) -> Scene:
    """`scene`, which is split by its layout's own lists. Raises InputError where files say another split."""
    by_files = split_by_files(scene, known_as, absent)
    if by_files is not None:
        differing = {view.name: view.split for view in scene.views}.items() ^ {
            view.name: view.split for view in by_files.views
        }.items()
        if differing:
            names = listed(sorted({name for name, _ in differing}))
            raise InputError(
                scene.root, f"{names} in {by_files.split_by} otherwise than in {scene.split_by}", f"one split{_CURE}"
            )
    return scene


def _with_splits(scene: Scene, splits: Mapping[str, Split | None], kept: Sequence[int]) -> Scene:
    views = []
    for index in kept:
        split = splits[scene.views[index].name]
        assert split is not None  # of views that are kept
        views.append(replace(scene.views[index], split=split))
    points = scene.points
    if points is not None and len(kept) < len(scene.views):
        points = points.seen_by(kept)
    return replace(scene, views=tuple(views), points=points)


def _applied(
    split: FileSplit, scene: Scene, known_as: Mapping[Path, str], absent: Collection[str]
) -> dict[str, Split | None]:
    """Every view's split by one file; None for views that are for validation alone."""
    index = ImageNames([_names(scene.root, view.source, view.name, known_as) for view in scene.views], partial=True)
    gone = ImageNames([(name,) for name in absent], partial=True)
    lists = {part: _views(split, part, index, scene, gone) for part in split.names}
    train, test, val = (lists.get(part) for part in _LISTS)
    both = (train or set()) & (test or set())
    if both:
        raise InputError(split.file, f"{listed(sorted(both))} in train and in test", f"a view in one of them{_CURE}")
    everything = {view.name for view in scene.views}
    alone = (val or set()) - train - test if train is not None and test is not None else set()
    if train is None:
        train = everything - (test or set())
    if test is None:
        test = everything - train
    nowhere = sorted(everything - train - test - alone)
    if nowhere:
        raise InputError(split.file, f"{listed(nowhere)} in neither list", f"every view in train or test{_CURE}")
    if not train or not test:
        raise InputError(split.file, f"{len(train)} training and {len(test)} test views", f"some of each{_CURE}")
    return {name: "test" if name in test else "train" if name in train else None for name in sorted(everything)}


def _names(root: Path, source: Path, view: str, known_as: Mapping[Path, str]) -> tuple[str, ...]:
    """What a list may call a view: relative to its folder of images, to the scene's; or its name here."""
    path = source.relative_to(root).as_posix() if source.is_relative_to(root) else source.name
    known = known_as.get(source, path.partition("/")[2] or path)
    return known, path, f"images/{known}", view


def _views(split: FileSplit, part: str, index: ImageNames, scene: Scene, gone: ImageNames) -> set[str]:
    views: set[str] = set()
    unknown = []
    for name in split.names[part]:
        images = index.find(name).images
        if len(images) > 1:
            several = listed(os.path.relpath(scene.views[image].source, scene.root) for image in images)
            raise InputError(split.file, f"{name}, which may be {several}", f"whole paths{_CURE}")
        if not images:
            unknown.append(name)
        views.update(scene.views[image].name for image in images)
    folders = {view.source.parent for view in scene.views}
    strangers = [name for name in unknown if not gone.find(name).images and not _is_image(name, folders)]
    if strangers:
        raise InputError(
            split.file, f"{listed(strangers)} in {part}, which no image is called", f"names of images{_CURE}"
        )
    return views


def _is_image(name: str, folders: Iterable[Path]) -> bool:
    """Whether there is such an image that has no pose: structure from motion doesn't find all."""
    files = [path for folder in folders for path in image_files(folder)]
    return bool(ImageNames([(path.as_posix(),) for path in files], partial=True).find(name).images)


def _of_texts(root: Path, folder: Path) -> FileSplit | None:
    files = {part: folder / f"{part}.txt" for part in _LISTS if (folder / f"{part}.txt").is_file()}
    if not files.keys() & {"train", "test"}:
        return None
    names = {part: _lines(file) for part, file in files.items()}
    source = " and ".join(file.relative_to(root).as_posix() for file in files.values())
    return FileSplit(source, next(iter(files.values())), names)


def _lines(file: Path) -> tuple[str, ...]:
    lines = (line.strip() for line in read_text(file, "the name of an image in each line").split("\n"))
    return _checked([line for line in lines if line and not line.startswith("#")], file, file.stem)


def _of_json(root: Path, file: Path) -> FileSplit:
    expected = f'{{"train": [...], "test": [...]}}, names of images{_CURE}'
    content = read_json(file)
    lists = {part: content[part] for part in _LISTS if part in content} if isinstance(content, dict) else {}
    if not lists.keys() & {"train", "test"} or not all(isinstance(names, list) for names in lists.values()):
        raise InputError(file, "no lists train and test", expected)
    return FileSplit(file.name, file, {part: _checked(names, file, part) for part, names in lists.items()})


def _checked(names: Sequence[object], file: Path, part: str) -> tuple[str, ...]:
    checked = tuple(plain_inside(name, file) for name in names)
    if len(set(checked)) < len(checked):
        twice = sorted({name for name in checked if checked.count(name) > 1})
        raise InputError(file, f"{listed(twice)} several times in {part}", f"every name once{_CURE}")
    return checked
