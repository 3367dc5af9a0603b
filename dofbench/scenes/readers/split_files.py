"""Splits that files name: test.txt and train.txt, in the scene folder or beside its COLMAP model, and lists in JSON.

3DGS reads sparse/0/test.txt; Zip-NeRF and others read train.txt and test.txt; ScanNet++ has train_test_lists.json.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.core.readable import read_text
from dofbench.scenes.readers.colmap_places import find_model
from dofbench.scenes.readers.folders import image_files, listed
from dofbench.scenes.readers.name_match import ImageNames, plain_inside
from dofbench.scenes.scene import Scene, Split

_JSON = ("split.json", "train_test_lists.json")
_LISTS = ("train", "test", "val")
# What the lists of split.json may be called: train; transforms.json's train_filenames; Nerfies' train_ids.
_KEYS = ("", "_filenames", "_ids", "_names", "_images", "_files")
# Phototourism's table, also called after the scene (brandenburg.tsv); other columns are free.
_TABLES, _COLUMNS = ("split.tsv", "split.csv"), ("filename", "split")
# Files that look like a split and aren't read: splits.json, split_0.npz, train_list.txt.
_ALIKE = re.compile(
    r"(?:(?:.*[_-])?splits?(?:[_-].*)?|(?:train|test|val)(?:[_-](?:.*[_-])?(?:list|lists|views|images|ids|files|names|set))?)"
    r"\.(?:tsv|csv|json|txt|npy|npz|pkl|ya?ml|toml)",
    re.IGNORECASE,
)
_CURE = "; or give --hold N, by which such files aren't read"


@dataclass(frozen=True)
class FileSplit:
    """Names by list, from one file or the files of one folder. source: those, for messages. partial: views in no list
    are excluded."""

    source: str
    file: Path
    names: Mapping[str, tuple[str, ...]]
    partial: bool = False


def find_splits(root: Path) -> list[FileSplit]:
    """The splits in files of a scene folder. Raises InputError for unreadable files."""
    model = find_model(root)
    folders = [root] if model is None else [root, model]
    found = [split for folder in folders if (split := _of_texts(root, folder)) is not None]
    found += [_of_json(root / name) for name in _JSON if (root / name).is_file()]
    return found + [_of_table(file, *table) for file, table in _tables(root).items()]


def split_sources(root: Path) -> list[str]:
    """The files of a scene folder that name a split, relative to it."""
    model = find_model(root)
    texts = [folder / f"{part}.txt" for folder in (root, model) if folder is not None for part in ("train", "test")]
    files = (*texts, *(root / name for name in _JSON), *_tables(root))
    return [file.relative_to(root).as_posix() for file in files if file.is_file()]


def unread_note(root: Path) -> str:
    """A note on files in a scene folder that are named like a split but aren't read; empty without any."""
    read = {*split_sources(root), *(f"{part}.txt" for part in _LISTS)}
    unread = sorted(path.name for path in root.iterdir() if _ALIKE.fullmatch(path.name) and path.name not in read)
    if not unread:
        return ""
    return f"{listed(unread)} not read: a split is read from test.txt, train.txt, split.json or split.tsv"


def split_by_files(scene: Scene, known_as: Mapping[Path, str], absent: Collection[str] = ()) -> Scene | None:
    """Split the scene by its files; None without such a file.

    known_as: names of the image files (`SceneView.source`) in the file with the poses. absent: names of skipped images,
    which may be listed. One list of train and test implies the other; with both, views for validation alone (val) are
    excluded. Raises InputError for names of no image or several, views in two lists or none, and contradicting files.
    """
    found = find_splits(scene.root)
    return split_by(scene, found, known_as, absent) if found else None


def split_by(
    scene: Scene, found: Sequence[FileSplit], known_as: Mapping[Path, str], absent: Collection[str] = ()
) -> Scene:
    """As `split_by_files`, for given splits, at least one."""
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
    why = "in neither" if any(split.partial for split in found) else "for validation alone"
    return replace(chosen, split_by=by).noted(f"{note}, {dropped} {why} skipped" if dropped else note)


def agreed(scene: Scene, known_as: Mapping[Path, str], absent: Collection[str]) -> Scene:
    """The scene, split by its layout's own lists. Raises InputError where files state another split."""
    by_files = split_by_files(scene, known_as, absent)
    if by_files is not None:
        differing = {(view.name, view.split) for view in scene.views} ^ {(v.name, v.split) for v in by_files.views}
        if differing:
            names = listed(sorted({name for name, _ in differing}))
            found = f"{names} in {by_files.split_by} otherwise than in {scene.split_by}"
            raise InputError(scene.root, found, f"one split{_CURE}")
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
    """Every view's split by one file; None for views for validation alone."""
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
    if nowhere and not split.partial:
        raise InputError(split.file, f"{listed(nowhere)} in neither list", f"every view in train or test{_CURE}")
    if not train or not test:
        raise InputError(split.file, f"{len(train)} training and {len(test)} test views", f"some of each{_CURE}")
    return {name: "test" if name in test else "train" if name in train else None for name in sorted(everything)}


def _names(root: Path, source: Path, view: str, known_as: Mapping[Path, str]) -> tuple[str, ...]:
    """Names of a view in a list: relative to its folder of images, or to the scene; or the view's name."""
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
        found = f"{listed(strangers)} in {part}, which no image is called"
        raise InputError(split.file, found, f"names of images{_CURE}")
    return views


def _is_image(name: str, folders: Iterable[Path]) -> bool:
    """Whether the name is that of an image without a pose."""
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


def _of_json(file: Path) -> FileSplit:
    expected = f'{{"train": [...], "test": [...]}}, names of images{_CURE}'
    content = read_json(file)
    lists = {}
    for part in _LISTS if isinstance(content, dict) else ():
        keys = [key for suffix in _KEYS if (key := f"{part}{suffix}") in content]
        if len(keys) > 1:
            raise InputError(file, f"{' and '.join(keys)}", f"one list of them{_CURE}")
        if keys:
            lists[part] = content[keys[0]]
    numbered = [part for part, names in lists.items() if isinstance(names, list) and any(map(_is_number, names))]
    if numbered:
        raise InputError(file, f"indices in {' and '.join(numbered)}, of views in an unknown order", expected)
    if not lists.keys() & {"train", "test"} or not all(isinstance(names, list) for names in lists.values()):
        raise InputError(file, "no lists train and test", expected)
    return FileSplit(file.name, file, {part: _checked(names, file, part) for part, names in lists.items()})


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _tables(root: Path) -> dict[Path, tuple[str, list[list[str]]]]:
    """Separator and rows, header first, of tables with a split: split.tsv, split.csv, and other .tsv with its
    columns."""
    found: dict[Path, tuple[str, list[list[str]]]] = {}
    others = sorted(path for path in root.iterdir() if path.suffix.lower() == ".tsv" and path.name not in _TABLES)
    for file in (*(root / name for name in _TABLES), *others):
        if not file.is_file():
            continue
        try:
            text = read_text(file, f"a table with columns {' and '.join(_COLUMNS)}")
        except InputError:
            if file.name in _TABLES:
                raise
            continue
        separator = "\t" if "\t" in text.partition("\n")[0] else ","
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), delimiter=separator) if row]
        header = [cell.lower() for cell in rows[0]] if rows else []
        if file.name in _TABLES or set(_COLUMNS) <= set(header):
            found[file] = (separator, [header, *rows[1:]])
    return found


def _of_table(file: Path, separator: str, rows: Sequence[Sequence[str]]) -> FileSplit:
    """The split of a table by file name. Rows without a split, or without an id where there is such a column, belong to
    images in no list, as do missing rows."""
    header, *rest = rows
    if not set(_COLUMNS) <= set(header):
        found = f"columns {', '.join(header) or 'none'}"
        raise InputError(file, found, f"columns {' and '.join(_COLUMNS)}, separated by {separator!r}{_CURE}")
    named: dict[str, list[str]] = {part: [] for part in _LISTS}
    for number, row in enumerate(rest, start=2):
        if len(row) != len(header):
            raise InputError(file, f"{len(row)} columns in line {number}", f"{len(header)}, as its header{_CURE}")
        values = dict(zip(header, row, strict=True))
        part = values["split"].lower()
        if not values["filename"] or not part or not values.get("id", "0"):
            continue
        if part not in _LISTS:
            raise InputError(file, f"split {values['split']} in line {number}", f"{', '.join(_LISTS)}{_CURE}")
        named[part].append(values["filename"])
    lists = {part: _checked(names, file, part) for part, names in named.items() if names or part != "val"}
    return FileSplit(file.name, file, lists, partial=True)


def _checked(names: Sequence[object], file: Path, part: str) -> tuple[str, ...]:
    checked = tuple(plain_inside(name, file) for name in names)
    if len(set(checked)) < len(checked):
        twice = sorted({name for name in checked if checked.count(name) > 1})
        raise InputError(file, f"{listed(twice)} several times in {part}", f"every name once{_CURE}")
    return checked
