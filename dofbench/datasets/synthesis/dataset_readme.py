"""The README of a dataset: its content, how it was made, how to read it."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence

from dofbench import __version__
from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS, Photographer
from dofbench.core.markdown_text import block, code, literal, visible
from dofbench.datasets.format.points_record import PointsRecord, points_in_words
from dofbench.datasets.format.schema import DepthRecord, SourceRecord, ThinLensRecord, ViewRecord
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.lens_plan import Values
from dofbench.scenes.named.schema import NOT_STATED
from dofbench.scenes.scene import Scene

# Usual names of the file that states a scene's origin and terms.
_NOTES = (
    "CITATION.cff",
    "LICENCE",
    "LICENCE.md",
    "LICENCE.txt",
    "LICENSE",
    "LICENSE.md",
    "LICENSE.txt",
    "README.md",
    "README.txt",
    "SOURCE.md",
)

DEPTH_TEXT = {
    "given": "the scene's own depth maps",
    "folder": "depth maps of another program",
    "splat": "a Gaussian reconstruction of all all-in-focus views (settings in dataset.json)",
    "sfm": "sparse points, completed along the edges of the image",
    "onnx": "a monocular depth network (named in dataset.json), aligned to sparse points",
}

_TEXT = """\
# {title}: shallow depth of field with a known lens

![A few views: original, depth, circle of confusion, shallow photograph](contact_sheet.png)

{count} views ({train} to train on, {test} to test on), {size}. Every image in `images/` is a photograph of an
all-in-focus scene, blurred as a lens of known aperture and focus would. `lens.json` holds that lens, so what a
method learns from the images can be compared with the truth.

Made by dofbench {version}:

{command}

Running it again on the same scene gives the same bytes{but}:
`dofbench make-dataset SCENE --like dataset.json --out DIR` does so and compares them. `dofbench check` compares every
file with its checksum in `dataset.json`, and blurs a part of a view again.

## What scores on it are evidence of

{evidence}

## Files

| file | what it is |
| --- | --- |
| `images/VIEW.png` | shallow depth of field, encoded, {bits} bit: what a method trains on |
| `images_linear/VIEW.exr` | the same in linear light, before encoding and rounding, {linear} |
| `all_in_focus/VIEW.png` | the original at this size, encoded, 8 bit: the truth for all-in-focus renders |
{light}| `depth/VIEW.exr` | z-depth in scene units, float32, 0 where unknown; from {depth} |
| `confidence/VIEW.png` | how far to trust that, 8 bit: 0 unknown, 255 certain; what it is: `depth` in `dataset.json` |
{masks}| `lens.json` | aperture and focus of every view, and what they refer to |
| `transforms.json` | cameras, split and depth in nerfstudio's layout (OpenGL axes) |
| `poses_bounds.npy` | the same cameras in LLFF's layout |
| `sparse/0/` | the same cameras and the sparse points as a COLMAP model |
| `contact_sheet.png` | a few views: original, depth, CoC radius, shallow image |
| `dataset.json` | source, settings, sha256 and size of every other file |

## What a method sees

{seen}

## Lens

With `[q_min, q_max] = disparity_range` of `lens.json` and a pixel's depth z:

    d = (1 / z - q_min) / (q_max - q_min)        normalised disparity, 0 far ... 1 near, not clipped
    R = k_px |d - focus|                         radius of its circle of confusion, pixels
    k_px = 0.02 * image width * aperture

The same in scene units: `R = aperture_scene |1 / focus_scene - 1 / z|`. Blurring is done in linear light,
`linear = encoded ** {gamma:g}`: each pixel i of colour c is spread over its neighbours j at distance l with the weight

    w_ij = (1/2 + 1/2 tanh({alpha:g} (R_i - l))){area}

and a target's colour is `sum_i w_ij c_i / sum_i w_ij`{shape}.{layered}
A view with aperture 0 is the original, untouched.
{again}
Where the depth is unknown, 1 / z counts as 0: infinitely far.{sensor}
{normaliser}
The lenses were {dealt}; the largest radius is {largest:.1f} pixels.

## Reading it

    from dofbench import Dataset
    dataset = Dataset.load({quoted})
    training_set = dataset.training_set()        # shallow images, cameras, points; nothing of the lens or depth
    view = dataset.test_views()[0]
    dataset.image(view), dataset.all_in_focus(view), dataset.depth(view), view.lens

Depth and 8-bit images open in any image library that knows EXR and PNG; `transforms.json` and `sparse/0` open in
nerfstudio, gsplat, COLMAP and their like. Views in `test_filenames` of `transforms.json` are not for training.
{lost}
## Source

The all-in-focus images are those of the scene "{title}" ({layout} layout){origin}; their sha256 are in `dataset.json`.

{licence}
"""

MASKS_TEXT = (
    "8 bit, where a view has masked pixels: 0 masked, neither trained on nor scored; in the images they are replaced "
    "by their nearest valid pixels"
)
_MASKS = f"| `masks/VIEW.png` | {MASKS_TEXT}; also 0 where more than 1 % of the light comes from such pixels |\n"

_LAYERED = """ This is done
in {layers} layers of equal range of the signed radius, laid over each other from far to near, each going on behind the
nearer ones."""

_LIGHT = """\
| `all_in_focus_linear/VIEW.exr` | the original as linear light, {linear}, may exceed 1: what is blurred |
"""

_AGAIN = "Who computes this from `{}`, `depth` and `lens.json` gets `images` to within the rounding to {} bits."

_THINLENS = """\

These photographs, however, were not computed from an image and its depth, which the formula above only comes near: they
were rendered through a real thin lens of the same radius R, by mitsuba {mitsuba} ({variant}), {samples} rays a pixel,
from the geometry of make-scene's recipe `{recipe}`, seed {seed}. `lens.json` has the noise of every view."""

_PER_VIEW = """
The lens of every view was dealt in the view's own units (minimum and 95th percentile of its disparity; `dealt` in
`lens.json`), and is given in the scene's units as everywhere, so `aperture` and `focus` differ from view to view.
"""


def readme_text(
    scene: Scene,
    settings: MakeDataset,
    source: SourceRecord,
    depth: DepthRecord,
    points: PointsRecord,
    records: Sequence[ViewRecord],
    lost: Sequence[str],
    thinlens: ThinLensRecord | None = None,
) -> str:
    """The README's text, without properties of the machine or the time. lost: what a layout can't represent of the
    cameras."""
    sizes = sorted({(view.camera.width, view.camera.height) for view in scene.views})
    blur = settings.blur
    linear = "half" if settings.linear == "exr-half" else "float"
    sharp = "all_in_focus_linear" if all(image.linear for image in source.images) else "all_in_focus"
    return _TEXT.format(
        title=literal(scene.name),
        quoted=json.dumps(visible(scene.name), ensure_ascii=False),
        layout=scene.layout,
        version=__version__,
        command=block(settings.command(settings.scene or scene.name)),
        count=len(records),
        train=sum(record.split == "train" for record in records),
        test=sum(record.split == "test" for record in records),
        size=" and ".join(f"{width}x{height}" for width, height in sizes) + " pixels",
        linear=linear,
        light=_LIGHT.format(linear=linear) if any(image.linear for image in source.images) else "",
        depth=DEPTH_TEXT[depth.source],
        masks=_MASKS if any(image.mask for image in source.images) else "",
        seen=seen_text(points),
        gamma=blur.gamma,
        alpha=blur.alpha,
        area=" / (R_i^2 + 0.2)" if blur.energy == "area" else "",
        shape="" if blur.shape.is_disc else "; R_i is scaled by direction to the aperture's `shape`",
        layered=_LAYERED.format(layers=blur.layers) if blur.renderer == "layered" else "",
        again=_AGAIN.format(sharp, settings.bits) if thinlens is None else _THINLENS.format(**thinlens.model_dump()),
        normaliser=_PER_VIEW if settings.normaliser == "view" else "",
        largest=max(record.max_coc_px for record in records),
        dealt=_dealt_text(settings),
        bits=settings.bits,
        sensor=_sensor_text(settings),
        lost="".join(f"\nCareful: {literal(note)}.\n" for note in lost) + reading_text(scene),
        but=" but for a rare last bit of the ray tracer's" if blur.renderer == "thinlens" else "",
        origin=f", from {literal(source.origin)}" if source.origin else "",
        evidence=evidence_text(source, settings.renderer),
        licence=licence_text(scene, source),
    )


def evidence_text(source: SourceRecord, photographer: Photographer) -> str:
    """The role of the scene, with the file that states it, and what took the photographs."""
    named = (source.role_by or "").partition("/")[0]
    by = f" Stated in {code(f'datasets/{named}.toml')}." if source.role_by else ""
    return f"- {ROLE_SAYS[source.role]}{by}\n- {PHOTOGRAPHER_SAYS[photographer]}"


def seen_text(points: PointsRecord) -> str:
    """What a method sees, in lines of 120 characters: where points and poses come from, and which points are given."""
    text = f"The photographs and cameras of the training views, and {points.given} points. {points_in_words(points)}"
    if points.given < points.count:
        text += (
            f" `sparse/0` has all {points.count} points; `Dataset.training_set` gives those whose track names a "
            "training view."
        )
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def reading_text(scene: Scene) -> str:
    """What was chosen, changed or skipped while the scene was read; empty where nothing was."""
    return "".join(f"\nWhile reading the scene: {literal(note)}.\n" for note in scene.notes)


def licence_text(scene: Scene, source: SourceRecord) -> str:
    """The terms of the images, where to find details, and whom to cite."""
    terms = f" ({literal(source.terms)})" if source.terms else ""
    lines = [f"Licence of the images: {literal(source.licence)}{terms}."]
    notes = [f"`{name}`" for name in _NOTES if (scene.root / name).is_file()]
    if notes:
        lines.append(f"The scene's own words on terms and authors: {' and '.join(notes)} of its folder.")
    elif source.licence == NOT_STATED:
        lines.append("Find out their terms before you share them.")
    if source.citation:
        lines += ["Please cite:", "", *(f"- {literal(reference)}" for reference in source.citation)]
    else:
        lines.append("Please cite their authors.")
    return "\n".join(lines)


def _dealt_text(settings: MakeDataset) -> str:
    if settings.assign == "continuous":
        ends = (f"{min(values):g} to {max(values):g}" for values in (settings.focus, settings.aperture))
        return "drawn from focus {} and aperture {}".format(*ends)
    text = f"dealt from {_values_text(settings.values)}"
    if settings.held_out_values is None:
        return text
    return f"{text} for the views to train on, from {_values_text(settings.held_out_values)} for those to test on"


def _values_text(values: Values) -> str:
    focus, aperture = (", ".join(f"{value:g}" for value in numbers) for numbers in (values.focus, values.aperture))
    return f"focus {focus} and aperture {aperture}"


def _sensor_text(settings: MakeDataset) -> str:
    if not settings.sensor.is_noisy:
        return ""
    shot = f"x / {settings.photons:g} + " if settings.photons > 0 else ""
    return (
        f"\nNoise of the variance {shot}{settings.read_noise:g} ** 2 at a linear signal x is on `images` and "
        "`images_linear` (its numbers are `sensor` in\n`lens.json`)."
    )
