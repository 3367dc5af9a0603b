"""The README of a dataset of photographs of unknown lens."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from dofbench import __version__
from dofbench.core.image_files.exif import Exif
from dofbench.core.markdown_text import block, literal, visible
from dofbench.datasets.format.points_record import PointsRecord
from dofbench.datasets.format.schema import DepthRecord, SourceRecord
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.dataset_readme import (
    DEPTH_TEXT,
    MASKS_TEXT,
    evidence_text,
    licence_text,
    reading_text,
    seen_text,
)
from dofbench.scenes.scene import Scene

_TEXT = """\
# {title}: photographs with shallow depth of field, lens unknown

![A few views: the photograph, and what else is known of it](contact_sheet.png)

{count} views ({train} to train on, {test} to test on), {size}. Every image in `images/` is a photograph as it was
taken{resized}, in 8 bits: {shallow} of them are shallow, by a lens that nobody knows, and {sharp} all in focus. Only
distortion that the scene's cameras have is taken out.

Made by dofbench {version}:

{command}

Running it again on the same scene gives the same bytes:
`dofbench make-dataset SCENE --like dataset.json --out DIR` does so and compares them. `dofbench check` compares every
file with its checksum in `dataset.json`.

## What scores on it are evidence of

{evidence}

## Files

| file | what it is |
| --- | --- |
{files}

## What a method sees

{seen}

{exif}## What is not known, and so is not here

{missing}

## Reading it

    from dofbench import Dataset
    dataset = Dataset.load({quoted})
    training_set = dataset.training_set()        # photographs, cameras, points
    view = dataset.test_views()[0]
    view.lens                                    # None: nobody knows it
    dataset.all_in_focus(view)                   # None where there is no sharp photograph
    dataset.depth(view)                          # None where there is no depth
    view.exif                                    # what the camera wrote down; None where nothing is known

`transforms.json` and `sparse/0` open in nerfstudio, gsplat, COLMAP and their like. Views in `test_filenames` of
`transforms.json` are not for training: of some of them `images/` has a sharp photograph.
{lost}
## Source

The photographs are those of the scene "{title}" ({layout} layout){origin}; their sha256 are in `dataset.json`.

{licence}
"""


def photographs_readme(
    scene: Scene,
    settings: MakeDataset,
    source: SourceRecord,
    depth: DepthRecord | None,
    points: PointsRecord,
    lost: Sequence[str],
    *,
    bounded: bool,
) -> str:
    """The README's text, without properties of the machine or the time. lost: what a layout can't represent of the
    cameras. bounded: whether there is a poses_bounds.npy."""
    views = scene.views
    sizes = sorted({(view.camera.width, view.camera.height) for view in views})
    sharp = [view.name for view in views if view.photograph == "all-in-focus"]
    measured = 0 if depth is None else len(depth.views)
    origin = "" if depth is None else DEPTH_TEXT[depth.source]
    masked = any(image.mask for image in source.images)
    files = _files(
        len(sharp), measured, origin, len(views), bounded, any(view.exif is not None for view in views), masked
    )
    return _TEXT.format(
        title=literal(scene.name),
        quoted=json.dumps(visible(scene.name), ensure_ascii=False),
        layout=scene.layout,
        version=__version__,
        count=len(views),
        train=sum(view.split == "train" for view in views),
        test=sum(view.split == "test" for view in views),
        size=" and ".join(f"{width}x{height}" for width, height in sizes) + " pixels",
        resized=" but for its size" if settings.width is not None else "",
        shallow=len(views) - len(sharp),
        sharp=len(sharp),
        command=block(settings.command(settings.scene or scene.name)),
        files="\n".join(f"| {name} | {what} |" for name, what in files),
        seen=seen_text(points),
        exif=_exif_text(scene),
        missing="\n".join(f"- {line}" for line in _missing(len(sharp), measured, len(views), bounded)),
        lost="".join(f"\nCareful: {literal(note)}.\n" for note in lost) + reading_text(scene),
        origin=f", from {literal(source.origin)}" if source.origin else "",
        evidence=evidence_text(source, "unknown"),
        licence=licence_text(scene, source),
    )


def _files(
    sharp: int, measured: int, origin: str, count: int, bounded: bool, exif: bool, masked: bool
) -> list[tuple[str, str]]:
    files = [("`images/VIEW.png`", "the photograph, encoded, 8 bit")]
    if sharp:
        files.append(
            (
                "`all_in_focus/VIEW.png`",
                f"the same of the {sharp} views whose photograph is all in focus: the truth for all-in-focus renders",
            )
        )
    if measured:
        files += [
            (
                "`depth/VIEW.exr`",
                f"z-depth in scene units, float32, 0 where unknown, of {measured} of {count} views; from {origin}",
            ),
            ("`confidence/VIEW.png`", "where it is known, 8 bit: 0 or 255"),
        ]
    if masked:
        files.append(("`masks/VIEW.png`", MASKS_TEXT))
    files += [
        (
            "`lens.json`",
            "that the lens is unknown, for every view" + (", and the range of the known disparity" if measured else ""),
        ),
        ("`transforms.json`", "cameras and split in nerfstudio's layout (OpenGL axes)"),
    ]
    if bounded:
        files.append(("`poses_bounds.npy`", "the same cameras in LLFF's layout"))
    if exif:
        files.append(
            (
                "`exif.json`",
                "what the cameras wrote down of the photographs: f-number, focal length, exposure "
                "and the like, as far as known",
            )
        )
    return [
        *files,
        ("`sparse/0/`", "the same cameras and the sparse points as a COLMAP model"),
        ("`contact_sheet.png`", "a few views"),
        ("`dataset.json`", "source, settings, sha256 and size of every other file"),
    ]


_EXIF = """\
## What the cameras wrote down

{lines}

With one focal length and one sensor, the lens's opening is in proportion to 1 / f-number. Of each view: `exif.json`.

"""


def _exif_text(scene: Scene) -> str:
    """A section with one line per f-number; empty if no photograph has EXIF."""
    by_number: dict[float | None, list[Exif]] = {}
    for view in scene.views:
        record = view.exif or Exif()
        by_number.setdefault(record.f_number, []).append(record)
    if not any(view.exif is not None for view in scene.views):
        return ""
    columns = {"focal_length": "focal length, mm", "exposure": "exposure, s", "iso": "ISO"}
    if any(view.exif is not None and view.exif.focus_distance is not None for view in scene.views):
        columns["focus_distance"] = "in focus at, m"
    rows = [("f-number", "photographs", *columns.values()), ("---",) * (2 + len(columns))]
    for number in sorted(by_number, key=lambda number: (number is None, number or 0.0)):
        records = by_number[number]
        known = [_range_text([getattr(record, name) for record in records]) for name in columns]
        rows.append(("not known" if number is None else f"f/{number:g}", str(len(records)), *known))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return _EXIF.format(lines="\n".join(lines))


def _range_text(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "not known"
    low, high = ("infinity" if end == math.inf else f"{end:.4g}" for end in (min(known), max(known)))
    return (low if low == high else f"{low} to {high}") + ("" if len(known) == len(values) else f", of {len(known)}")


def _missing(sharp: int, measured: int, count: int, bounded: bool) -> list[str]:
    missing = [
        "The lens of every view: no aperture, no focus, so no refocused render and no learned lens can be scored.",
        "The photographs in linear light: how they were encoded isn't known either.",
    ]
    if sharp < count:
        missing.append(f"A sharp photograph of {count - sharp} of {count} views.")
    if measured < count:
        missing.append(f"Depth of {count - measured} of {count} views.")
    if not bounded:
        missing.append("`poses_bounds.npy`: without depth and without points nobody knows how near and far things are.")
    return missing
