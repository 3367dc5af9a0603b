"""The README of a dataset: its content, how it was made, how to read it."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from dofbench import __version__
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS, Photographer
from dofbench.core.image_files.exif import Exif
from dofbench.core.markdown_text import block, code, literal, visible
from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.datasets.format.schema import DepthRecord, SourceRecord, ViewRecord
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.lens_plan import Values
from dofbench.datasets.synthesis.render_views import Photography
from dofbench.scenes.named.schema import NOT_STATED
from dofbench.scenes.scene import Scene

# Usual names of the file that states a scene's origin and terms.
_TERMS = (
    "CITATION.cff", "LICENCE", "LICENCE.md", "LICENCE.txt", "LICENSE", "LICENSE.md", "LICENSE.txt", "README.md",
    "README.txt", "SOURCE.md",
)  # fmt: skip
_DEPTH = {
    "given": "the scene's own depth maps",
    "folder": "depth maps of another program",
    "splat": "a Gaussian reconstruction of all all-in-focus views (settings in dataset.json)",
    "sfm": "sparse points, completed along the edges of the image",
    "onnx": "a monocular depth network (named in dataset.json), aligned to sparse points",
    "sweep": "a plane sweep over the light field's views around each",
}
_EXIF = {"focal_length": "focal length, mm", "exposure": "exposure, s", "iso": "ISO"}


def dataset_readme(
    scene: Scene,
    settings: MakeDataset,
    source: SourceRecord,
    depth: DepthRecord,
    points: PointsRecord,
    records: Sequence[ViewRecord],
    lost: Sequence[str],
    shared: Photography,
) -> str:
    """Describe a dataset of known lens, without properties of the machine or the time.

    lost: what a layout can't represent of the cameras. shared: how its images were made.
    """
    linear = [bool(image.linear) for image in source.images]
    return _rendered(
        "dataset.md.j2",
        _common(scene, settings, source, points, lost, shared.blur.renderer)
        | {
            "records": records,
            "blur": shared.blur,
            "thinlens": shared.thinlens,
            "light_field": shared.light_field,
            "float": "half" if settings.linear == "exr-half" else "float",
            "some_linear": any(linear),
            "all_linear": all(linear),
            "depth_from": _DEPTH[depth.source],
            "assigned": _assigned(settings),
            "largest": max(record.max_coc_px for record in records),
        },
    )


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
    """Describe a dataset of real photographs; see `dataset_readme`. bounded: whether there is a poses_bounds.npy."""
    return _rendered(
        "photographs.md.j2",
        _common(scene, settings, source, points, lost, "unknown")
        | {
            "sharp": sum(view.photograph == "all-in-focus" for view in scene.views),
            "measured": 0 if depth is None else len(depth.views),
            "depth_from": "" if depth is None else _DEPTH[depth.source],
            "bounded": bounded,
            "exif": _exif_rows(scene),
        },
    )


def _rendered(template: str, values: Mapping[str, Any]) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        autoescape=False,  # Markdown: texts from files go through the filters
    )
    environment.filters |= {"literal": literal, "block": block, "code": code}
    return environment.get_template(template).render(values)


def _common(
    scene: Scene,
    settings: MakeDataset,
    source: SourceRecord,
    points: PointsRecord,
    lost: Sequence[str],
    photographer: Photographer,
) -> dict[str, Any]:
    sizes = sorted({(view.camera.width, view.camera.height) for view in scene.views})
    named = (source.role_by or "").partition("/")[0]
    by = f" Stated in {code(f'datasets/{named}.toml')}." if source.role_by else ""
    return {
        "scene": scene,
        "settings": settings,
        "source": source,
        "lost": lost,
        "version": __version__,
        "command": settings.command(settings.scene or scene.name),
        "quoted": json.dumps(visible(scene.name), ensure_ascii=False),
        "counts": {split: sum(view.split == split for view in scene.views) for split in ("train", "test")},
        "size": " and ".join(f"{width}x{height}" for width, height in sizes) + " pixels",
        "masked": any(image.mask for image in source.images),
        "evidence": f"- {ROLE_SAYS[source.role]}{by}\n- {PHOTOGRAPHER_SAYS[photographer]}",
        "seen": _seen(points),
        "stated": source.licence != NOT_STATED,
        "terms_files": [name for name in _TERMS if (scene.root / name).is_file()],
    }


def _seen(points: PointsRecord) -> str:
    """What a method receives, in lines of 120 characters."""
    text = f"The images and cameras of the training views, and {points.given} points. {points_in_words(points)}"
    if points.given < points.count:
        text += (
            f" `sparse/0` has all {points.count} points; `Dataset.training_set` gives those whose track names a "
            "training view."
        )
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def _assigned(settings: MakeDataset) -> str:
    if settings.assign == "continuous":
        ends = (f"{min(values):g} to {max(values):g}" for values in (settings.focus, settings.values.aperture))
        return "drawn from focus {} and aperture {}".format(*ends)
    text = f"assigned from {_values(settings.values)}"
    if settings.held_out_values is None:
        return text
    return f"{text} for the training views, from {_values(settings.held_out_values)} for the test views"


def _values(values: Values) -> str:
    focus, aperture = (", ".join(f"{value:g}" for value in numbers) for numbers in (values.focus, values.aperture))
    return f"focus {focus} and aperture {aperture}"


def _exif_rows(scene: Scene) -> list[tuple[str, ...]]:
    """A table with one row per f-number; empty if no photograph has EXIF."""
    if not any(view.exif is not None for view in scene.views):
        return []
    by_number: dict[float | None, list[Exif]] = {}
    for view in scene.views:
        record = view.exif or Exif()
        by_number.setdefault(record.f_number, []).append(record)
    columns = dict(_EXIF)
    if any(record.focus_distance is not None for records in by_number.values() for record in records):
        columns["focus_distance"] = "focus distance, m"
    rows = [("f-number", "photographs", *columns.values()), ("---",) * (2 + len(columns))]
    for number in sorted(by_number, key=lambda number: (number is None, number or 0.0)):
        records = by_number[number]
        known = [_range([getattr(record, name) for record in records]) for name in columns]
        rows.append(("unknown" if number is None else f"f/{number:g}", str(len(records)), *known))
    return rows


def _range(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "unknown"
    low, high = ("infinity" if end == math.inf else f"{end:.4g}" for end in (min(known), max(known)))
    return (low if low == high else f"{low} to {high}") + ("" if len(known) == len(values) else f", of {len(known)}")
