"""Verifies a dataset folder: schema, checksums, lens arithmetic, split, and the blur itself."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import image_size, read_exr, read_image, to_8bit
from dofbench.core.lens import Lens
from dofbench.core.similarity import psnr as psnr_of
from dofbench.datasets.format import layout
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.schema import (
    MANIFEST,
    LensFile,
    Manifest,
    UnknownLens,
    UnknownLensFile,
    ViewRecord,
    read_lens_file,
    read_manifest,
)
from dofbench.datasets.synthesis import write
from dofbench.datasets.synthesis.depth_record import check_depth
from dofbench.datasets.synthesis.lens_plan import PlannedView
from dofbench.datasets.synthesis.points_check import check_points
from dofbench.datasets.synthesis.render_views import Photography, shallow_image, shallow_light, view_record
from dofbench.optics.tone import decode, encode
from dofbench.runtime.threads import allowed_threads
from dofbench.runtime.view_threads import over_views, views_at_once
from dofbench.scenes.depth.disparity import disparity_of
from dofbench.scenes.named.library import contradiction, role_of_recipe

# DB, least PSNR of a photograph against the recomputed blur; rounding to 8 bits alone gives 58.9
RECOMPUTED_PSNR = 55.0
# DB, least PSNR of a photograph through a real lens against the scatter, which differs at depth edges and highlights
SCATTERED_PSNR = 18.0
_WINDOW = 64  # pixels, side of the window of a view whose blur is recomputed
_AGREEMENT = 1e-9  # tolerated relative difference between numbers of lens.json, which are float64


def check_dataset(folder: Path | str) -> list[str]:
    """All problems of a dataset folder, one line each; empty for a valid dataset.

    Every file is compared with its checksum; the lens of every view is recomputed; a part of the most blurred view is
    blurred again, by the scatter in float64 or by the dataset's renderer (averages of a light field are compared with
    the scatter, loosely); the depth of every view is compared with its
    neighbours'; points that the dataset's making triangulated are triangulated again. Unknown properties of real
    photographs must be marked as unknown, and the scene's role must be the one that the named datasets' files state.
    Raises InputError only if there is no manifest.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    problems = _check_files(folder, manifest)
    try:
        lenses = read_lens_file(folder)
    except InputError as error:
        return [*problems, str(error)]
    problems += _check_lenses(folder, lenses, manifest)
    problems += _check_role(lenses, manifest)
    if problems:
        return problems
    try:
        dataset = Dataset.load(folder)
    except InputError as error:
        return [str(error)]
    blur = _check_blur(folder, lenses) if isinstance(lenses, LensFile) else []
    return [*blur, *check_depth(dataset), *check_points(dataset)]


def blurred_again(
    sharp: np.ndarray,
    depth: np.ndarray,
    record: ViewRecord,
    lenses: LensFile,
    rows: slice,
    columns: slice,
    *,
    linear: bool = False,
) -> np.ndarray:
    """A window of a view's shallow photograph, computed from its definition: a direct sum in float64.

    sharp: (H, W, 3) encoded, [0, 1], or light where `linear`; depth: (H, W), scene units. Returns (h, w, 3) float64,
    encoded, unrounded.
    Only the sources that reach the window are summed.
    """
    import torch

    from dofbench.optics.defocus import scatter_of

    width = sharp.shape[1]
    radius = record.physical(width).signed_radius(disparity_of(depth), width)
    blur, sensor = lenses.blur, lenses.sensor.sensor()
    noise = sensor.standard_noise(record.name, sharp.shape)[rows, columns] if sensor.is_noisy else None
    if record.aperture == 0:
        inside = sharp[rows, columns].astype(np.float64)
        if noise is None:
            return encode(inside, blur.gamma) if linear else inside
        return encode(sensor.expose(inside if linear else decode(inside, blur.gamma), noise), blur.gamma)
    # Beyond its radius a source's weight falls by exp(-2 alpha) per pixel; after 40 / (2 alpha) pixels it is
    # negligible.
    reach = math.ceil(np.abs(radius).max() + 40 / (2 * blur.alpha))
    top, left = max(0, rows.start - reach), max(0, columns.start - reach)
    around = np.s_[top : rows.stop + reach, left : columns.stop + reach]
    light = sharp[around].astype(np.float64)
    # One thread, because in hundreds of sums over a small window more threads would mostly wait for each other.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        blurred = scatter_of(blur, "reference")(
            torch.from_numpy(light if linear else decode(light, blur.gamma)),
            torch.from_numpy(np.ascontiguousarray(radius[around])),
        ).numpy()
    finally:
        torch.set_num_threads(threads)
    window = blurred[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return encode(window if noise is None else sensor.expose(window, noise), blur.gamma)


def _check_files(folder: Path, manifest: Manifest) -> list[str]:
    def check(name: str) -> str:
        path, record = folder / name, manifest.files[name]
        if not path.is_file():
            return f"{name}: missing"
        if path.stat().st_size != record.size:
            return f"{name}: {path.stat().st_size} bytes, {record.size} in {MANIFEST}"
        return "" if sha256_file(path) == record.sha256 else f"{name}: content differs from its checksum in {MANIFEST}"

    problems = list(filter(None, over_views(check, manifest.files, allowed_threads())))
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    problems += [f"{name}: not in {MANIFEST}" for name in sorted(found - manifest.files.keys() - {MANIFEST})]
    expected = set(write.expected_files(folder, manifest.source, manifest.depth))
    problems += [f"{name}: not listed in {MANIFEST}" for name in sorted(expected - manifest.files.keys() - found)]
    return problems


def _check_lenses(folder: Path, lenses: LensFile | UnknownLensFile, manifest: Manifest) -> list[str]:
    names = [record.name for record in lenses.views]
    problems = []
    if sorted(names) != sorted(image.view for image in manifest.source.images):
        problems.append(f"lens.json: {len(names)} views, not those of the {len(manifest.source.images)} source images")
    problems += _check_photographs(lenses, manifest)
    if isinstance(lenses, UnknownLensFile):
        return [*problems, *_check_split(lenses, manifest)]
    if lenses.normaliser != manifest.settings.get("normaliser", "scene"):
        problems.append(f"lens.json: normaliser {lenses.normaliser}, {manifest.settings.get('normaliser')} in settings")

    def check(record: ViewRecord) -> list[str]:
        depth_path, image_path = layout.depth_path(folder, record.name), layout.shallow_path(folder, record.name)
        is_there = depth_path.is_file() and image_path.is_file()
        return _check_lens(record, lenses, read_exr(depth_path)) if is_there else []

    there = (path for record in lenses.known if (path := layout.depth_path(folder, record.name)).is_file())
    at_once = views_at_once(max((math.prod(image_size(path)) for path in there), default=0))
    problems += [problem for found in over_views(check, lenses.known, at_once) for problem in found]
    problems += _check_split(lenses, manifest)
    return problems


def _check_role(lenses: LensFile | UnknownLensFile, manifest: Manifest) -> list[str]:
    """The role must be what the named datasets' files say, also of the recipe and seed of a rendered scene."""
    source = manifest.source
    problems = [f"{MANIFEST}: {said}"] if (said := contradiction(source.role, source.role_by or "")) else []
    if isinstance(lenses, LensFile) and lenses.thinlens is not None and source.role is not None:
        recipe, seed = lenses.thinlens.recipe, lenses.thinlens.seed
        known = role_of_recipe(recipe, seed)
        if known is not None and known.role != source.role:
            problems.append(
                f"{MANIFEST}: role {source.role}, and {known.by} says {known.role} of recipe {recipe}, seed {seed}"
            )
    return problems


def _check_lens(record: ViewRecord, lenses: LensFile, depth: np.ndarray) -> list[str]:
    """Check that the view's numbers agree with each other, and its largest radius with its depth."""
    dealt = record.dealt or record
    planned = PlannedView(record.name, record.split, Lens(dealt.aperture, dealt.focus))
    again = view_record(planned, depth, _shared(lenses, record))
    problems = []
    for field in ("aperture", "focus", "k_px", "aperture_scene", "focus_scene", "max_coc_px"):
        stored, expected = getattr(record, field), getattr(again, field)
        if not math.isclose(stored, expected, rel_tol=_AGREEMENT, abs_tol=_AGREEMENT):
            problems.append(f"lens.json: view {record.name}: {field} {stored:.9g}, computed {expected:.9g}")
    return problems


def _shared(lenses: LensFile, record: ViewRecord) -> Photography:
    sensor, bits = lenses.sensor.sensor(), lenses.sensor.bits
    return Photography(lenses.range(), record.dealt is not None, lenses.blur, sensor=sensor, bits=bits)


def _check_photographs(lenses: LensFile | UnknownLensFile, manifest: Manifest) -> list[str]:
    """Exactly the views that are real photographs must have no lens; if such a photograph is sharp, it must also be the
    view's all-in-focus image."""
    problems = []
    photograph = {image.view: image.photograph for image in manifest.source.images}
    for view in lenses.views:
        unknown, taken = isinstance(view, UnknownLens), photograph.get(view.name)
        if unknown is (taken is None):
            said = "a real photograph" if taken else "no real photograph"
            problems.append(
                f"lens.json: view {view.name}: lens {'unknown' if unknown else 'known'}, and in {MANIFEST} {said}"
            )
        images, sharp = (layout.relative(place, view.name) for place in (layout.shallow_path, layout.sharp_path))
        if unknown and sharp in manifest.files and manifest.files[sharp] != manifest.files.get(images):
            problems.append(f"{sharp}: another picture than {images}")
    known_depth = any(record.startswith("depth/") for record in manifest.files)
    if isinstance(lenses, UnknownLensFile) and known_depth is (lenses.disparity_range is None):
        problems.append(
            f"lens.json: {'no ' if known_depth else 'a '}disparity range, and "
            f"{'depth' if known_depth else 'no depth'} in {MANIFEST}"
        )
    return problems


def _check_split(lenses: LensFile | UnknownLensFile, manifest: Manifest) -> list[str]:
    """No photograph may be in both splits under two names; compared by content."""
    digest = {}
    for record in lenses.views:
        place = layout.shallow_path if isinstance(record, UnknownLens) else layout.sharp_path
        if (name := layout.relative(place, record.name)) in manifest.files:
            digest[record.name] = manifest.files[name].sha256
    training = {digest[view.name]: view.name for view in lenses.views if view.split == "train" and view.name in digest}
    return [
        f"view {view.name}, to test on: the same photograph as view {training[digest[view.name]]}, to train on"
        for view in lenses.views
        if view.split == "test" and view.name in digest and digest[view.name] in training
    ]


def _check_blur(folder: Path, lenses: LensFile) -> list[str]:
    record = max(lenses.known, key=lambda view: view.max_coc_px)
    sharp, depth = read_image(layout.sharp_path(folder, record.name)), read_exr(layout.depth_path(folder, record.name))
    shallow = read_image(layout.shallow_path(folder, record.name))
    light_path = layout.sharp_linear_path(folder, record.name)
    light = read_exr(light_path) if light_path.is_file() else None
    rows, columns = (_middle(size) for size in sharp.shape[:2])
    if lenses.thinlens is not None and record.aperture > 0:
        return _check_thin_lens(folder, record, lenses, rows, columns)
    if lenses.light_field is not None and record.aperture > 0:
        return _near_the_scatter(folder, record, lenses, rows, columns)
    if lenses.renderer == "scatter":
        source = sharp if light is None else light
        again = blurred_again(source, depth, record, lenses, rows, columns, linear=light is not None)
    elif light is not None:
        again = shallow_light(light, depth, record, _shared(lenses, record))[0][rows, columns]
    else:
        again = shallow_image(to_8bit(sharp), depth, record, _shared(lenses, record))[0][rows, columns]
    psnr = psnr_of(np.clip(again, 0, 1), shallow[rows, columns])  # clipped like the PNG, since noise may exceed white
    if psnr < RECOMPUTED_PSNR:
        return [f"images/{record.name}.png: {psnr:.1f} dB from the blur computed again, expected {RECOMPUTED_PSNR:g}"]
    return []


def _check_thin_lens(folder: Path, record: ViewRecord, lenses: LensFile, rows: slice, columns: slice) -> list[str]:
    """Render the window again, with other random numbers; without mitsuba, compare with the scatter, which is
    similar."""
    from dofbench.datasets.synthesis.photographing import Optics, exposed

    assert lenses.thinlens is not None
    file = f"images/{record.name}.png"
    shallow = read_image(layout.shallow_path(folder, record.name))[rows, columns]
    try:
        optics = Optics(lenses.thinlens.recipe, lenses.thinlens.seed, lenses.thinlens.samples)
    except InputError as missing:
        print(f"{folder}: compared with the scatter alone, loosely: {missing}", file=sys.stderr, flush=True)
        return _near_the_scatter(folder, record, lenses, rows, columns)
    camera = Dataset.load(folder).view(record.name).camera
    shot = optics.photograph(camera, record, window=(rows, columns))
    whole = np.zeros((camera.height, camera.width, 3), np.float32)
    whole[rows, columns] = shot.linear
    again = exposed(whole, record.name, lenses.sensor.sensor(), lenses.blur.gamma)[0][rows, columns]
    psnr = psnr_of(np.clip(again, 0, 1), shallow)
    # The noise of two renderings adds up, which costs 3 dB; another 3 dB are allowed because the noise is an estimate.
    expected = min(RECOMPUTED_PSNR, shot.noise_psnr - 6)
    if psnr < expected:
        return [f"{file}: {psnr:.1f} dB from the lens rendered again, expected {expected:.1f}, as its noise allows"]
    return []


def _near_the_scatter(folder: Path, record: ViewRecord, lenses: LensFile, rows: slice, columns: slice) -> list[str]:
    """Compare with the scatter of the sharp image, where the blur itself can't be computed again."""
    sharp = read_image(layout.sharp_path(folder, record.name))
    depth = read_exr(layout.depth_path(folder, record.name))
    shallow = read_image(layout.shallow_path(folder, record.name))[rows, columns]
    scattered = blurred_again(sharp, depth, record, lenses, rows, columns)
    nearer, farther = psnr_of(np.clip(scattered, 0, 1), shallow), psnr_of(sharp[rows, columns], shallow)
    if nearer < SCATTERED_PSNR or nearer < farther:
        return [
            f"images/{record.name}.png: {nearer:.1f} dB from the scatter and {farther:.1f} dB from the sharp image, "
            f"expected at least {SCATTERED_PSNR:g} dB, and nearer to the scatter"
        ]
    return []


def _middle(size: int) -> slice:
    side = min(size, _WINDOW)
    return slice((size - side) // 2, (size - side) // 2 + side)
