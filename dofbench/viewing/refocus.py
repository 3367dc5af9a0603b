"""`dofbench refocus`: one image with another focus and aperture, from its depth, by the layered renderer.

The image is taken as all in focus; what is blurred in it stays so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import read_image, resize, write_exr, write_png
from dofbench.core.lens import COC_FRACTION, GAMMA, ApertureShape, DisparityRange
from dofbench.core.progress import say
from dofbench.optics.defocus import scatter_of
from dofbench.optics.layered import layered_blur
from dofbench.optics.tone import fast_decode, fast_encode
from dofbench.scenes.depth.network import Network, find_network
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.readers.exif_files import exif_of_image
from dofbench.viewing.refocus_options import Refocus

_FULL_FRAME = math.hypot(36.0, 24.0)  # mm
_ASPECT = 0.02  # relative difference of the aspect ratios of an image and its depth file
_RANGE = 1.0, 99.0  # percentiles of the disparity that are called 0 and 1
_PATCH = 0.005  # half the width of the square in focus, as a share of the image's width
_GUIDE_EPS = 1e-3  # of the guided filter (He et al., 2010), squared encoded values


@dataclass(frozen=True, eq=False)
class ImageDisparity:
    """values: (H, W) float32, of the image's size. metric: whether in 1 / metre; else up to a scale and a shift."""

    values: np.ndarray
    metric: bool


def refocus(settings: Refocus) -> Path:
    """Write the image refocused; returns its path.

    Raises InputError for an unreadable image, depth or network, and for an f-number without metric depth or focal
    length.
    """
    image = read_image(settings.image)
    exif = exif_of_image(settings.image)
    focal = _focal_length(settings, exif, image)
    disparity = image_disparity(settings, image, focal)
    low, high = (float(value) for value in np.percentile(disparity.values[::4, ::4], _RANGE))
    bounds = DisparityRange(low, high if high > low else low + 1.0)  # a plane has any range
    normalised = bounds.normalise(disparity.values)
    focus = _at(normalised, settings.at) if settings.focus is None else settings.focus
    strength = COC_FRACTION * image.shape[1] * settings.aperture
    if settings.f_number is not None:
        strength = _half_opening(settings, exif, disparity.metric, focal) * (focal or 0.0) * bounds.extent
    shape = ApertureShape(settings.blades, math.radians(settings.rotation))
    refocused = blurred(image, (strength * (normalised - focus)).astype(np.float32), shape)
    out = settings.out or Path(f"{settings.image.stem}-refocused.png")
    if settings.save_depth is not None:
        write_exr(settings.save_depth, normalised)
    if out.suffix.lower() == ".exr":
        write_exr(out, fast_decode(torch.from_numpy(refocused), GAMMA).numpy(), half=True)
    else:
        write_png(out, np.clip(refocused, 0.0, 1.0))
    reach = strength * max(abs(float(normalised.max()) - focus), abs(float(normalised.min()) - focus))
    say(Console(stderr=True), f"focus {focus:.2f} of 0 far to 1 near, blur radius up to {reach:.0f} px")
    say(Console(), str(out))
    return out


def blurred(image: np.ndarray, signed_radius: np.ndarray, shape: ApertureShape = ApertureShape()) -> np.ndarray:
    """The encoded image (H, W, 3) blurred in layers by signed radii (H, W), pixels; for images of any size."""
    light = fast_decode(torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32)), GAMMA)
    radius = torch.from_numpy(np.ascontiguousarray(signed_radius))
    if not bool((radius != 0).any()):
        return image
    with torch.no_grad():
        return fast_encode(layered_blur(light, radius, scatter_of(Blur(shape=shape)), coarse=True), GAMMA).numpy()


def image_disparity(settings: Refocus, image: np.ndarray, focal: float | None) -> ImageDisparity:
    """Disparity of the image (H, W, 3), encoded, as `settings.depth` says. focal: pixels, None where unknown."""
    source, _, name = settings.depth.partition(":")
    if source == "onnx":
        if settings.depth_unit is not None:
            raise InputError("--depth-unit", f"--depth {settings.depth}", "a depth file, which has a unit")
        return _of_network(Network(find_network(name)), settings.image, image, focal)
    depth = read_depth(Path(settings.depth), settings.depth_unit or 1.0)
    height, width = image.shape[:2]
    if abs(depth.shape[1] / depth.shape[0] * height / width - 1) > _ASPECT:
        found = f"{depth.shape[1]} x {depth.shape[0]} pixels"
        raise InputError(settings.depth, found, f"the aspect ratio of the image, {width} x {height}")
    disparity = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float32), where=depth > 0, dtype=np.float32)
    return ImageDisparity(resize(disparity, width, height), settings.depth_unit is not None)


def _of_network(network: Network, file: Path, image: np.ndarray, focal: float | None) -> ImageDisparity:
    """A network's map at the image's size, along the image's edges."""
    import cv2

    values, described = network.predict(image, file.name), network.description
    if described.output == "depth":
        values = np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)
    metric = described.align != "scale-shift"
    if metric and described.output == "disparity" and described.align == "scale":
        # Canonical inverse depth: that of a camera whose focal length is the image's width.
        metric = focal is not None
        values = values * (image.shape[1] / focal if focal else 1.0)
    height, width = image.shape[:2]
    if values.shape != (height, width):
        reach = math.ceil(2 * width / values.shape[1])
        values = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
        spread = float(np.ptp(values)) or 1.0
        guide = np.ascontiguousarray(image, dtype=np.float32)
        # On a fourth of the pixels: its coefficients are smooth over the window.
        scale = 0.25 if reach > 8 else 1.0
        values = (
            cv2.ximgproc.guidedFilter(guide, np.asarray(values / spread, np.float32), reach, _GUIDE_EPS, scale=scale)
            * spread
        )
    return ImageDisparity(values.astype(np.float32), metric)


def _at(normalised: np.ndarray, share: tuple[float, ...]) -> float:
    """Median around a point, given as shares of width and height."""
    height, width = normalised.shape
    half = max(1, round(_PATCH * width))
    column, row = min(int(share[0] * width), width - 1), min(int(share[1] * height), height - 1)
    patch = normalised[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
    return float(np.median(patch))


def _focal_length(settings: Refocus, exif: Exif, image: np.ndarray) -> float | None:
    """Focal length, pixels."""
    length = settings.focal_length_35mm or exif.focal_length_35mm
    return None if length is None else length / _FULL_FRAME * math.hypot(*image.shape[:2])


def _half_opening(settings: Refocus, exif: Exif, metric: bool, focal: float | None) -> float:
    """Half the width of the opening, metres, by the f-number."""
    assert settings.f_number is not None
    if not metric:
        found = f"depth without a scale, --depth {settings.depth}"
        raise InputError("--f-number", found, "depth in metres (docs/viewing.md), or --aperture")
    length = settings.focal_length_35mm or exif.focal_length_35mm
    if length is None or focal is None:
        raise InputError(settings.image, "no focal length in EXIF", "--focal-length-35mm for --f-number")
    if settings.sensor_diagonal is not None:
        length *= settings.sensor_diagonal / _FULL_FRAME
    elif exif.focal_length is not None and settings.focal_length_35mm is None:
        length = exif.focal_length
    return length / 1000 / (2 * settings.f_number)
