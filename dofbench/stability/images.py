"""Images of one pixel, one row, odd sizes and unusual channels; files; and make-dataset on the like."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.errors import InputError
from dofbench.images import (
    decode,
    encode,
    image_size,
    read_exr,
    read_image,
    resize,
    write_exr,
    write_grey_png,
    write_png,
)
from dofbench.kernels import load
from dofbench.layered import layered_blur
from dofbench.stability.case import (
    KERNELS,
    NUMPY,
    SINGLE,
    SINGLE_ON_CPU,
    Case,
    Found,
    Setting,
    differing,
    not_finite,
    off,
    refuses,
    values,
)
from dofbench.stability.gaussians import against_reference
from dofbench.stability.lens import EXACT, NAMED, ROUNDED, against_formula
from dofbench.stability.oracle import ROUNDINGS
from dofbench.stability.samples import gaussians, picture, radii, straight

SIZES = ((1, 1), (1, 9), (9, 1), (3, 5), (17, 33))
LEVEL = 1 / 255


def _named(size: tuple[int, int]) -> str:
    return f"{size[1]}x{size[0]}"


# ---- kernels ----


def _scatter(setting: Setting, size: tuple[int, int]) -> Found:
    return against_formula(setting, picture(*size), radii(0.4, 6.0, *size))


def _layered(setting: Setting, size: tuple[int, int]) -> Found:
    image = picture(*size)
    found = values(
        layered_blur(setting.tensor(image), setting.tensor(radii(0.4, 6.0, *size)), setting.kernel("scatter"))
    )
    if found.shape != image.shape or not_finite(found):
        return Found(math.inf, 0.0)
    return Found(max(0.0, float(image.min() - found.min()), float(found.max() - image.max())), 64 * setting.eps)


def _rasterize(setting: Setting, size: tuple[int, int]) -> Found:
    return against_reference(setting, gaussians(), camera=straight(size[1], size[0]))


def _ssim(setting: Setting, size: tuple[int, int]) -> Found:
    a, b = picture(*size), picture(*size, seed=1)
    double = Setting("reference", "float64")
    exact = float(load("ssim", "reference", function="l1_ssim")(double.tensor(a), double.tensor(b), ssim_weight=0.2))
    found = float(setting.kernel("ssim", "l1_ssim")(setting.tensor(a), setting.tensor(b), ssim_weight=0.2))
    # Variances are differences of numbers up to 1; their sum with C2 = 9e-4 is what is divided by.
    return Found(abs(found - exact), ROUNDINGS * setting.eps / (0.03 + 9e-4))


def _ssim_too_small(setting: Setting) -> Found:
    small = setting.tensor(picture(5, 5))
    return refuses(ValueError, lambda: setting.kernel("ssim")(small, small, border="valid"), "at least 11 x 11")


def _stereo(setting: Setting, size: tuple[int, int]) -> Found:
    grey, other = picture(*size)[..., 0], picture(*size, seed=3)[..., 0]
    maps = np.array([[[1.0, 0, 0, -0.7], [0, 1, 0, 0.2], [0, 0, 1, 0]]])
    planes = np.array([0.0, 1.0, 4.0])

    def sweep(kernel: Callable, where: Setting) -> np.ndarray:
        return values(
            kernel(
                where.tensor(grey),
                where.tensor(other[None]),
                where.tensor(maps.astype(np.float32)),
                where.tensor(planes),
                radius=2,
                best=1,
            )
        )

    exact = sweep(load("stereo", "reference"), Setting("reference", "float64"))
    # A correlation's error: coordinates of up to 33 pixels rounded, and variances down to the floor of 2e-5.
    return Found(off(sweep(setting.kernel("stereo"), setting), exact, 1.0), 33 * setting.eps / math.sqrt(2e-5))


def _channels(setting: Setting, count: int) -> Found:
    image, radius, scatter = picture(channels=count), setting.tensor(radii(0.4)), setting.kernel("scatter")
    together = values(scatter(setting.tensor(image), radius))
    apart = np.concatenate(
        [values(scatter(setting.tensor(image[..., k : k + 1]), radius)) for k in range(count)], axis=2
    )
    # How far the compiled kernel follows an edge depends on the brightest pixel of all channels done together.
    return Found(off(together, apart), (ROUNDINGS + radius.numel() / 2) * setting.eps + 2 * math.exp(-12.0))


def _no_pixels(setting: Setting) -> Found:
    empty = np.zeros((0, 5, 3), np.float32)
    return refuses(
        ValueError, lambda: setting.kernel("scatter")(setting.tensor(empty), setting.tensor(empty[..., 0])), "image"
    )


# ---- files ----


def _in_folder(measure: Callable[[Path], Found]) -> Callable[[Setting], Found]:
    def run(setting: Setting) -> Found:
        with tempfile.TemporaryDirectory(prefix="dofbench-stability-") as folder:
            return measure(Path(folder))

    return run


def _png(folder: Path, size: tuple[int, int], bits: int) -> Found:
    image = picture(*size)
    write_png(folder / "a.png", image, bits=bits)
    wrong = float(image_size(folder / "a.png") != (size[1], size[0]))
    steps = 2**bits - 1
    # Half a level; and a float32 number near 1.
    return Found(math.inf if wrong else off(read_image(folder / "a.png"), image, 1.0), 0.5 / steps + 2e-7)


def _exr(folder: Path, size: tuple[int, int]) -> Found:
    image, depth = picture(*size) * np.float32(1e6), picture(*size)[..., 0] * np.float32(1e-6)
    write_exr(folder / "a.exr", image)
    write_exr(folder / "z.exr", depth)
    return Found(differing(read_exr(folder / "a.exr"), image) + differing(read_exr(folder / "z.exr"), depth), 0.0)


def _exr_kept(folder: Path) -> Found:
    depth = picture()[..., 0]
    depth[0, :4] = (np.inf, -np.inf, np.nan, 1e-42)
    write_exr(folder / "z.exr", depth)
    found = read_exr(folder / "z.exr")
    return Found(float(not np.array_equal(found, depth, equal_nan=True)), 0.0)


def _half_exr(folder: Path) -> Found:
    image = picture() * np.float32(1000)
    image[0, 0] = (1e6, 7e4, 65504.0)
    write_exr(folder / "a.exr", image, half=True)
    found = read_exr(folder / "a.exr")
    saturated = np.minimum(image, 65504.0)
    return Found(off_or_infinite(found, saturated), 2.0**-11, "of each number")


def off_or_infinite(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest deviation as a share of each number; infinity where any isn't finite."""
    return math.inf if not_finite(found) else float((np.abs(found - expected) / expected).max())


def _one_channel(folder: Path) -> Found:
    grey = picture()[..., 0]
    write_grey_png(folder / "grey.png", grey)
    write_exr(folder / "grey.exr", grey)
    from_png, from_exr = read_image(folder / "grey.png"), read_image(folder / "grey.exr")
    repeated = np.repeat(grey[..., None], 3, axis=2)
    return Found(max(off(from_png, repeated, 1.0), off(from_exr, repeated, 1.0)), 0.5 * LEVEL + 2e-7)


def _alpha(folder: Path, bits: int, grey: bool) -> Found:
    import cv2

    steps = 2**bits - 1
    kind = np.uint8 if bits == 8 else np.uint16
    random = np.random.default_rng(0)
    colour, alpha = random.integers(0, steps + 1, (24, 32, 3)), random.integers(0, steps + 1, (24, 32, 1))
    if grey:  # OpenCV writes no grey with alpha: a colour image of equal channels stands for it
        colour = np.repeat(colour[..., :1], 3, axis=2)
    cv2.imwrite(str(folder / "a.png"), np.concatenate([colour[..., ::-1], alpha], axis=2).astype(kind))
    expected = colour / steps * (alpha / steps)
    # A product of two levels, rounded to one level by whoever reads it in the file's own depth.
    return Found(off(read_image(folder / "a.png"), expected, 1.0), 1.0 / steps + 2e-7)


def _resized(setting: Setting) -> Found:
    image = picture(5, 7)
    wrong = off(resize(image, 1, 1), image.mean(axis=(0, 1), keepdims=True))
    point = picture(1, 1)
    for width, height in ((1, 1), (3, 3), (1, 5)):
        grown = resize(point, width, height)
        wrong = max(wrong, off(grown, np.broadcast_to(point, (height, width, 3))))
    flat = np.full((9, 13, 3), 0.37, np.float32)
    wrong = max(wrong, *(off(resize(flat, w, h), np.full((h, w, 3), 0.37)) for w, h in ((4, 3), (20, 17), (1, 9))))
    return Found(wrong, 32 * setting.eps)


def _damaged(folder: Path) -> Found:
    write_png(folder / "whole.png", picture())
    content = (folder / "whole.png").read_bytes()
    wrong, note = 0.0, ""
    for name, cut in (("empty.png", 0), ("header.png", 30), ("half.png", len(content) // 2)):
        (folder / name).write_bytes(content[:cut])
        found = refuses(InputError, partial(read_image, folder / name), name)
        wrong, note = wrong + found.error, note or found.note.replace(str(folder), "")
    return Found(wrong, 0.0)


def _pure_power(setting: Setting) -> Found:
    tones = np.array([0.0, 1e-30, 1e-3, 0.5, 1.0], np.float32)
    wrong = max(off(encode(decode(tones, gamma), gamma), tones) for gamma in (1.0, 2.2))
    return Found(wrong, 32 * setting.eps)


# ---- make-dataset ----


def _write_scene(
    folder: Path,
    size: tuple[int, int],
    *,
    views: int = 3,
    photograph: Callable | None = None,
    depth: Callable | None = None,
) -> Path:
    """A scene in nerfstudio's layout: pictures with one depth, by a camera that stays where it is."""
    height, width = size
    frames = []
    for index in range(views):
        image, z = picture(*size, seed=index), (2.0 + 3.0 * picture(*size)[..., 0]).astype(np.float32)
        image, z = photograph(image) if photograph else image, depth(z) if depth else z
        name = f"images/v{index}" + (".exr" if photograph else ".png")
        write_exr(folder / name, image) if photograph else write_png(folder / name, image)
        write_exr(folder / f"depth/v{index}.exr", z)
        frames.append(
            {"file_path": name, "depth_file_path": f"depth/v{index}.exr", "transform_matrix": np.eye(4).tolist()}
        )
    (folder / "transforms.json").write_text(
        json.dumps(
            {"w": width, "h": height, "fl_x": 32.0, "fl_y": 32.0, "cx": width / 2, "cy": height / 2, "frames": frames}
        )
    )
    return folder


def _make(scene: Path, out: Path, **options) -> Path:
    from dofbench.synthesis import make_dataset
    from dofbench.synthesis.progress import Silent
    from dofbench.synthesis.settings import MakeDataset

    return make_dataset(MakeDataset(scene=str(scene), out=out, hold=2, **options), progress=Silent())


def _dataset(folder: Path, size: tuple[int, int], depth: Callable | None = None, **options) -> Found:
    """That the dataset is made, and is what it says: `dofbench check` recomputes its photographs."""
    from dofbench.synthesis import check_dataset

    made = _make(_write_scene(folder / "scene", size, depth=depth), folder / "made", **options)
    problems = check_dataset(made)
    records = json.loads((made / "lens.json").read_text())["views"]
    wrong = sum(not_finite(read_exr(file)) for file in sorted((made / "images_linear").glob("*.exr")))
    wrong += sum(
        not math.isfinite(record[key]) for record in records for key in ("max_coc_px", "aperture_scene", "k_px")
    )
    return Found(wrong + len(problems), 0.0, "; ".join(map(str, problems))[:160].replace(str(folder), ""))


def _not_encoded(folder: Path, value: float) -> Found:
    def spoiled(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[1, 1] = value
        return image

    scene = _write_scene(folder / "scene", (24, 32), photograph=spoiled)
    found = refuses(InputError, lambda: _make(scene, folder / "made"), "v0.exr", "an encoded image")
    return Found(found.error, found.bound, found.note.replace(str(folder), ""))


def _bad_depth(folder: Path, value: float) -> Found:
    def spoiled(z: np.ndarray) -> np.ndarray:
        z = z.copy()
        z[1, 1] = value
        return z

    scene = _write_scene(folder / "scene", (24, 32), depth=spoiled)
    found = refuses(InputError, lambda: _make(scene, folder / "made"), "v0.exr")
    return Found(found.error, found.bound, found.note.replace(str(folder), ""))


def _refused_option(folder: Path, option: str, value: str) -> Found:
    scene = _write_scene(folder / "scene", (24, 32))
    return refuses(InputError, lambda: _make(scene, folder / "made", **{option: value}), f"--{option}", value)


def _cases() -> tuple[Case, ...]:
    picture_case = partial(Case, "images")
    on_cpu = tuple(setting for setting in SINGLE if setting.device == "cpu")

    def files(name: str, holds: str, bound: str, measure: Callable[..., Found], **options) -> Case:
        subject = "make-dataset" if name.startswith("dataset") else "images"
        return picture_case(name, subject, holds, bound, NUMPY, _in_folder(partial(measure, **options)))

    return (
        *(
            picture_case(
                f"scatter-{_named(size)}",
                "scatter",
                f"{_named(size)} pixels: the formula's result",
                ROUNDED,
                KERNELS,
                partial(_scatter, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"layered-{_named(size)}",
                "layered",
                f"{_named(size)} pixels: no lighter or darker than any",
                "64 roundings",
                SINGLE_ON_CPU,
                partial(_layered, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"rasterize-{_named(size)}",
                "rasterize",
                f"{_named(size)} pixels: as the float64 reference",
                "8 times what rounding all parameters moves, and 64 roundings",
                SINGLE,
                partial(_rasterize, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"ssim-{_named(size)}",
                "ssim",
                f"{_named(size)} pixels: the float64 loss",
                "16 roundings over the least denominator",
                SINGLE,
                partial(_ssim, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"stereo-{_named(size)}",
                "stereo",
                f"{_named(size)} pixels: the float64 scores",
                "rounded coordinates over the least deviation",
                on_cpu,
                partial(_stereo, size=size),
            )
            for size in SIZES
        ),
        *(
            picture_case(
                f"channels-{count}",
                "scatter",
                f"{count} channels are blurred as each by itself",
                "16 roundings and one a pixel, twice exp(-12)",
                KERNELS,
                partial(_channels, count=count),
            )
            for count in (1, 2, 4, 5)
        ),
        picture_case(
            "no-pixels",
            "scatter",
            "an image without pixels is refused by name",
            NAMED,
            tuple(s for s in KERNELS if s.backend != "reference"),
            _no_pixels,
        ),
        picture_case(
            "ssim-5x5-valid",
            "ssim",
            "an image smaller than the window is refused by name",
            NAMED,
            KERNELS,
            _ssim_too_small,
        ),
        *(
            files(
                f"png-{bits}-bit-{_named(size)}",
                f"a PNG of {bits} bits, {_named(size)} pixels, comes back as it was",
                "half a level",
                _png,
                size=size,
                bits=bits,
            )
            for size in ((1, 1), (1, 9), (17, 33))
            for bits in (8, 16)
        ),
        *(
            files(
                f"exr-{_named(size)}", f"an EXR of {_named(size)} pixels comes back as it was", EXACT, _exr, size=size
            )
            for size in ((1, 1), (9, 1), (17, 33))
        ),
        files("exr-not-finite", "infinity, NaN and denormal numbers in an EXR come back", EXACT, _exr_kept),
        files(
            "exr-half",
            "numbers that half floats don't hold saturate, none becomes infinite",
            "half a unit of 11 bits",
            _half_exr,
        ),
        files("one-channel", "one channel is read as three alike", "half a level", _one_channel),
        *(
            files(
                f"alpha-{bits}-bit{'-grey' if grey else ''}",
                "alpha is composited over black",
                "a level",
                _alpha,
                bits=bits,
                grey=grey,
            )
            for bits in (8, 16)
            for grey in (False, True)
        ),
        files("damaged", "a file cut short is refused by its name", NAMED, _damaged),
        picture_case(
            "resize", "images", "to and from one pixel: means and constants stay", "32 roundings", NUMPY, _resized
        ),
        picture_case(
            "pure-power", "images", "decoding and encoding give tones back, 0 too", "32 roundings", NUMPY, _pure_power
        ),
        *(
            files(
                f"dataset-{_named(size)}",
                f"a dataset of {_named(size)} pixels is made and checks out",
                "0: no complaint",
                _dataset,
                size=size,
            )
            for size in ((1, 1), (1, 9), (9, 1), (17, 33))
        ),
        files(
            "dataset-flat",
            "a dataset of a plane, all depths equal, is made and checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            depth=lambda z: np.full_like(z, 3.7),
        ),
        files(
            "dataset-outlier",
            "a dataset with a pixel 10^6 times nearer is made and checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            depth=partial(_with_pixel, value=3e-6),
        ),
        files(
            "dataset-depth-infinite",
            "infinite depth counts as infinitely far, and the dataset checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            depth=partial(_with_pixel, value=np.inf),
        ),
        files(
            "dataset-depth-mostly-unknown",
            "a dataset with one known depth a view is made and checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            depth=_all_but_one_unknown,
        ),
        *(
            files(
                f"dataset-{option}-{value}",
                f"{option} {value} is refused by name",
                NAMED,
                _refused_option,
                option=option,
                value=value,
            )
            for option, value in (("focus", "-1"), ("focus", "nan"), ("aperture", "40"))
        ),
        files(
            "dataset-focus-ends",
            "focus at 0 and 1, aperture 0 and 1: made and checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            focus="0,1",
            aperture="0,1",
        ),
        files(
            "dataset-layered",
            "by layers, with a pixel 10^6 times nearer: made and checks out",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            depth=partial(_with_pixel, value=3e-6),
            renderer="layered",
        ),
        files(
            "dataset-noisy-black",
            "a noisy sensor in the dark: no number is lost",
            "0: no complaint",
            _dataset,
            size=(24, 32),
            photons=10.0,
            read_noise=20.0,
        ),
        *(
            files(
                f"dataset-photograph-{name}",
                f"a photograph with {value} is refused by its name",
                NAMED,
                _not_encoded,
                value=value,
            )
            for name, value in (("nan", np.nan), ("inf", np.inf), ("negative", -0.5))
        ),
        *(
            files(
                f"dataset-depth-{name}",
                f"a depth of {value} is refused by its file's name",
                NAMED,
                _bad_depth,
                value=value,
            )
            for name, value in (("nan", np.nan), ("negative", -2.0))
        ),
    )


def _with_pixel(z: np.ndarray, value: float) -> np.ndarray:
    z = z.copy()
    z[2, 3] = value
    return z


def _all_but_one_unknown(z: np.ndarray) -> np.ndarray:
    known = np.zeros_like(z)
    known[5, 6] = z[5, 6]
    return known


CASES = _cases()
