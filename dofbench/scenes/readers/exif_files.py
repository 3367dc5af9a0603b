"""EXIF of a scene's photographs, from exif.json, exif.csv or the image files, and splits by f-number."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from dofbench.core.errors import InputError
from dofbench.core.image_files.camera_files import camera_tags, is_camera_file
from dofbench.core.image_files.exif import LEAST, MOST, Exif, read_exif
from dofbench.core.readable import read_text
from dofbench.scenes.readers.focus_distance import focus_distance
from dofbench.scenes.readers.folders import image_header
from dofbench.scenes.readers.folders import listed as listed_names
from dofbench.scenes.readers.name_match import ImageNames
from dofbench.scenes.scene import Scene, Split

CSV_FILE = "exif.csv"
# Columns of exif.csv, and the fields of `Exif`.
_RENAMED = {"focal_length_mm": "focal_length", "focus_distance_m": "focus_distance", "exposure_s": "exposure"}
_COLUMNS = "f_number focal_length_mm focal_length_35mm focus_distance_m exposure_s iso time camera lens".split()
# OpenImageIO's names of EXIF's tags; of several, the first that is there.
_TAGS = {
    "f_number": ("FNumber", "Exif:FNumber"),
    "focal_length": ("Exif:FocalLength",),
    "focal_length_35mm": ("Exif:FocalLengthIn35mmFilm",),
    "exposure": ("ExposureTime", "Exif:ExposureTime"),
    "iso": ("Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"),
    # Not DateTime, which is when the file was last changed.
    "time": ("Exif:DateTimeOriginal", "Exif:DateTimeDigitized"),
    "lens": ("Exif:LensModel",),
}
_TEXTS = ("time", "camera", "lens")


def exif_by_file(root: Path, files: Mapping[str, Path]) -> dict[str, Exif]:
    """EXIF of each view's photograph, by view, without views of which nothing is known.

    files: by view. Sources: `root/exif.json`; else the file's line in the nearest exif.csv, in its folder or one above,
    up to the root (matched by `name_match`, by the path from the table's folder or its end); else the file itself.
    Raises InputError for a damaged exif.json or exif.csv, an ambiguous line, and lines that differ about one file.
    """
    written = read_exif(root)
    tables: dict[Path, list[str]] = {}
    for view, file in files.items():
        table = _table_above(file.parent, root)
        if table is not None and view not in written:
            tables.setdefault(table, []).append(view)
    listed: dict[str, Exif] = {}
    for table, views in tables.items():
        listed |= _listed(table, {view: files[view] for view in views})
    found = {}
    for view, file in files.items():
        record = written[view] if view in written else listed[view] if view in listed else exif_of_image(file)
        if record != Exif():
            found[view] = record
    return found


def exif_of_image(file: Path) -> Exif:
    """An image file's own EXIF; missing and impossible values are None, and nothing is raised."""
    tags = camera_tags(file) if is_camera_file(file) else _tags_of_image(file)
    values = {name: next((tags[tag] for tag in names if tag in tags), None) for name, names in _TAGS.items()}
    known: dict[str, Any] = {
        name: _text(value) if name in _TEXTS else _positive(value) for name, value in values.items() if name != "time"
    }
    return Exif(
        **known,
        focus_distance=focus_distance(file, tags),
        time=_time(values["time"]),
        camera=_camera(_text(tags.get("Make")), _text(tags.get("Model"))),
    )


def _tags_of_image(file: Path) -> dict[str, Any]:
    header = image_header(file)
    return {} if header is None else {attribute.name: attribute.value for attribute in header.extra_attribs}


def read_exif_csv(file: Path) -> dict[str, Exif]:
    """The lines of an exif.csv by the path or file name in the column `name`.

    Other columns: f_number, focal_length_mm, focal_length_35mm, focus_distance_m (inf for infinity), exposure_s, iso,
    time, camera, lens; each is optional, further ones are ignored. Raises InputError, with the line, for an impossible
    value.
    """
    reader = csv.DictReader(io.StringIO(read_text(file, "comma-separated text"), newline=""))
    try:
        names, lines = reader.fieldnames or [], list(reader)
    except csv.Error as error:
        raise InputError(file, f"no readable table ({error})", "comma-separated text") from None
    if "name" not in names:
        raise InputError(file, f"columns {', '.join(names) or 'none'}", f"name, and some of {', '.join(_COLUMNS)}")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(file, f"several columns {', '.join(twice)}", "each column once")
    records: dict[str, Exif] = {}
    for number, line in enumerate(lines, start=2):
        if not line["name"]:
            raise InputError(file, f"no name in line {number}", "one line a photograph")
        if line["name"] in records:
            raise InputError(file, f"{line['name']} a second time in line {number}", "one line a photograph")
        values = {_RENAMED.get(column, column): (line.get(column) or "").strip() for column in _COLUMNS}
        known = {
            name: value if name in _TEXTS else _number(file, number, name, value)
            for name, value in values.items()
            if value
        }
        if "time" in known:
            known["time"] = _time(known["time"])
        try:
            records[line["name"]] = Exif.of_data({name: value for name, value in known.items() if value is not None})
        except ValueError as error:
            raise InputError(file, f"line {number}: {error}", "a photograph's EXIF") from None
    return records


def _table_above(folder: Path, root: Path) -> Path | None:
    """The nearest exif.csv from the folder up to the root; None without one."""
    places = [folder]
    while places[-1] != root and root in places[-1].parents:
        places.append(places[-1].parent)
    return next((place / CSV_FILE for place in places if (place / CSV_FILE).is_file()), None)


def _listed(table: Path, files: Mapping[str, Path]) -> dict[str, Exif]:
    """The lines of a table for files below its folder, by view."""
    views, paths = list(files), [file.relative_to(table.parent).as_posix() for file in files.values()]
    shared = len(os.path.commonpath([PurePosixPath(path).parent for path in paths]))
    index = ImageNames([(path, _in_folder(path), path[shared:].lstrip("/")) for path in paths], partial=True)
    lines: dict[str, tuple[int, str]] = {}
    records = read_exif_csv(table)
    for name, record in records.items():
        match = index.find(name)
        if len(match.images) > 1:
            several = listed_names(paths[image] for image in match.images)
            raise InputError(table, f"{name}, which may be {several}", "whole paths where file names are equal")
        for image in match.images:
            step, other = lines.get(views[image], (match.step + 1, name))
            if step == match.step and records[other] != record:
                raise InputError(table, f"{other} and {name} for {paths[image]}", "one line a photograph")
            if match.step < step:
                lines[views[image]] = match.step, name
    return {view: records[name] for view, (_, name) in lines.items()}


def _in_folder(path: str) -> str:
    """As the path would be in the folder of full size: images/a.png for images_8/a.png."""
    folder, _, below = path.partition("/")
    return f"{re.sub(r'_[0-9]+$', '', folder)}/{below}" if below else path


def _number(file: Path, line: int, name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(file, f"line {line}: {name} {value!r}", "a number, or nothing") from None


def _positive(value: object) -> float | None:
    # Seven digits: OpenImageIO holds them as float32, and 2.799999952316284 is no camera's f-number.
    if isinstance(value, int | float) and LEAST <= value <= MOST:
        return float(f"{value:.7g}")
    return None


def _text(value: object) -> str | None:
    text = value.replace("\0", " ").strip() if isinstance(value, str) else ""
    return text or None


def _time(value: object) -> str | None:
    """ "2021:03:04 10:48:15", as EXIF writes it, to "2021-03-04 10:48:15"."""
    text = _text(value)
    if text is None or len(text) < 19 or not text[:4].isdigit():
        return None
    return None if text.startswith("0000") else f"{text[:10].replace(':', '-')} {text[11:19]}"


def _camera(make: str | None, model: str | None) -> str | None:
    """The maker's name and the model's, once where the model begins with it."""
    if model is None or make is None:
        return model or make
    return model if model.lower().startswith(make.split()[0].lower()) else f"{make} {model}"


SAME_F_NUMBER = 0.01  # relative; f-numbers are written down with two or three digits, and stops are 12 % apart


def split_by_f_number(scene: Scene, train: float, test: float, *, test_points: int = 0) -> Scene:
    """The scene with views of f-number `train` as training and of `test` as test views, without all others and the
    points seen only there.

    test_points: exclude test views that share fewer points with training views, where tracks are known. Raises
    InputError where either kind has no view.
    """
    splits: dict[int, Split] = {}
    for index, view in enumerate(scene.views):
        known = view.exif.f_number if view.exif is not None else None
        if known is not None and same_f_number(known, train):
            splits[index] = "train"
        elif known is not None and same_f_number(known, test):
            splits[index] = "test"
    for option, value, split in (("--train-f-number", train, "train"), ("--test-f-number", test, "test")):
        if split not in splits.values():
            raise InputError(option, f"no photograph at f/{value:g} in {scene.root}", f_numbers_in_words(scene))
    splits = _covered(scene, splits, test_points)
    kept = list(splits)
    views = tuple(replace(scene.views[index], split=splits[index]) for index in kept)
    return replace(scene, views=views, points=None if scene.points is None else scene.points.seen_by(kept))


def _covered(scene: Scene, splits: dict[int, Split], least: int) -> dict[int, Split]:
    if scene.points is None or scene.points.views is None or least <= 0:
        return splits
    shared = dict.fromkeys(splits, 0)
    for track in scene.points.views:
        seen = [int(view) for view in track]
        if any(splits.get(view) == "train" for view in seen):
            for view in seen:
                if splits.get(view) == "test":
                    shared[view] += 1
    kept = {view: split for view, split in splits.items() if split == "train" or shared[view] >= least}
    if "test" not in kept.values():
        found = f"{max(count for view, count in shared.items() if splits[view] == 'test')} shared points at most"
        raise InputError("--test-points", found, f"a view to test with that shares at least {least}")
    return kept


def same_f_number(one: float, two: float) -> bool:
    """Whether two f-numbers are one, but for how they were rounded."""
    return math.isclose(one, two, rel_tol=SAME_F_NUMBER)


def f_numbers_in_words(scene: Scene) -> str:
    """As "one of f/5 (10 photographs), f/14 (28)"."""
    counts: dict[float, int] = {}
    for view in scene.views:
        if view.exif is not None and view.exif.f_number is not None:
            counts[view.exif.f_number] = counts.get(view.exif.f_number, 0) + 1
    if not counts:
        return "f-numbers in the photographs' EXIF, in an exif.csv or an exif.json beside them"
    return "one of " + ", ".join(f"f/{number:g} ({count})" for number, count in sorted(counts.items()))
