"""The options of `make-dataset`: what a user types, and what it means once checked."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, GAMMA, LAYERS, ApertureShape, Energy, SceneRenderer
from dofbench.dataset.dealing import Assign
from dofbench.dataset.sensor import Sensor
from dofbench.synthesis.lens_plan import Values

DepthSource = Literal["auto", "given", "folder", "splat", "sfm", "onnx"]
Normaliser = Literal["scene", "view"]
Bits = Literal[8, 16]
Photographs = Literal["auto", "shallow", "shallow-train"]
LinearFormat = Literal["exr-half", "exr-float"]


# Options that mean nothing for photographs that are taken as they are.
_BLURRING = (
    "assign",
    "focus",
    "aperture",
    "test_focus",
    "test_aperture",
    "renderer",
    "layers",
    "lens_samples",
    "normaliser",
    "gamma",
    "alpha",
    "shape",
    "shape_rotation",
    "shape_curvature",
    "shape_obstruction",
    "energy",
    "photons",
    "read_noise",
    "bits",
    "linear",
    "depth_steps",
)


@dataclass(frozen=True)
class DatasetOptions:
    """What holds for one dataset and for many."""

    data_root: Path | None = None
    """Folder that holds named datasets (`dofbench scenes` lists them); without it, the one in DOFBENCH_DATA."""

    focus: str = "0.2,0.5,0.8"
    """Focus values, comma-separated: normalised disparity, 0 far to 1 near."""

    aperture: str = "0.5,1.0"
    """Aperture values, comma-separated: 1 blurs by 2 % of the width per unit of disparity, 0 not at all."""

    width: int | None = None
    """Image width in pixels; without it, a named dataset's usual one, else the scene's own."""

    hold: int | None = None
    """Every hold-th view, from the first, is a test view; without it, the named dataset's or the scene's own, or 8."""

    depth: str = "auto"
    """Where depth comes from: the scene (given), maps of z-depth in a folder (folder:DIR), a reconstruction (splat),
    its sparse points (sfm), a monocular network aligned to them (onnx:FILE with FILE.toml beside it, or the shipped
    onnx:depthnet), or given if there is any, else splat (auto)."""

    depth_unit: float = 1.0
    """Scene units per unit of the maps of --depth folder:DIR."""

    depth_steps: int = 3000
    """Training steps of the reconstruction behind --depth splat."""

    gamma: float = GAMMA
    """Display encoding: linear light is the encoded image to this power."""

    alpha: float = ALPHA
    """Hardness of the blur disc's edge, per pixel."""

    shape: str = "disc"
    """Aperture shape: disc, or N-gon with N blades, such as 5-gon."""

    shape_rotation: float = 0.0
    """Direction of the polygon's first corner, degrees from right towards down."""

    shape_curvature: float = 0.0
    """How far the polygon's blades bulge: 0 straight to 1 a disc."""

    shape_obstruction: float = 0.0
    """Radius of a central stop as a share of the aperture's, 0 to below 1."""

    energy: Energy = "area"
    """Scatter weight: divided by the disc's area, or as printed in the paper's Algorithm 1."""

    renderer: SceneRenderer = "scatter"
    """scatter: as in the paper, blind to what hides what; layered: depth layers composited from back to front;
    thinlens: rendered anew through a real lens, for a scene of make-scene's, with mitsuba."""

    layers: int = LAYERS
    """Depth layers of --renderer layered."""

    lens_samples: int = 4096
    """Rays a pixel, and so lens points, of --renderer thinlens."""

    normaliser: Normaliser = "scene"
    """What focus and aperture refer to: one disparity range for the scene, or one for every view."""

    assign: Assign = "per-view"
    """Deal the grid of focus and aperture over the views (per-view), give all views one lens, with a dataset for each
    lens of the grid (fixed), deal the test views a grid of their own (held-out), or draw from the ranges that the
    values span (continuous)."""

    test_focus: str | None = None
    """Focus values of the test views, none of them a training view's, for --assign held-out."""

    test_aperture: str | None = None
    """Aperture values of the test views for --assign held-out; without it, 0 and the training views'."""

    photons: float = 0.0
    """Shot noise: photons that a pixel at full scale collects, 0 for no such noise."""

    read_noise: float = 0.0
    """Read noise: standard deviation in linear light whose full scale is 1."""

    bits: Bits = 8
    """Bits per channel of the photographs that methods train on."""

    linear: LinearFormat = "exr-half"
    """Format of the images before encoding."""

    seed: int = 0
    """Seed of the deal and of the reconstruction."""

    images: str | None = None
    """Folder of images inside the scene; without it, the one that the layout prefers."""

    layout: str = "auto"
    """Layout of the scene folder: nerfstudio, llff, colmap, dofnerf, deblurnerf, or auto to find out. Where a folder is
    in several, this chooses; auto passes over a transforms.json in another frame than the COLMAP model beside it."""

    photographs: Photographs = "auto"
    """Whether the scene's photographs are shallow already, by a lens that nobody knows: as its layout says (auto), all
    of them (shallow), or those to train on while those to test with are sharp (shallow-train). They are taken as they
    are, and what isn't known of them is left out of the dataset."""

    train_f_number: float | None = None
    """Train on the photographs that were taken at this f-number alone, by their EXIF; with --test-f-number. For
    photographs that are shallow already."""

    test_f_number: float | None = None
    """Test with the photographs of this f-number, and leave out those of any other: the score is how well the learned
    aperture, scaled by the ratio of the two, predicts them."""

    test_points: int = 100
    """With --test-f-number: leave out the photographs of it that share fewer sparse points with those to train on. What
    no training photograph saw says nothing about an aperture."""

    out: Path | None = None
    """Folder to write, or with several datasets the folder that they all go into; without it, data/<scene name>."""

    def __post_init__(self) -> None:
        for option, value, lowest in (
            ("--width", self.width, 8),
            ("--hold", self.hold, 2),
            ("--depth-steps", self.depth_steps, 1),
            ("--seed", self.seed, 0),
            ("--layers", self.layers, 1),
            ("--test-points", self.test_points, 0),
            ("--lens-samples", self.lens_samples, 2),
        ):
            if value is not None and value < lowest:
                raise InputError(option, str(value), f"at least {lowest}")
        for option, number in (("--gamma", self.gamma), ("--alpha", self.alpha), ("--depth-unit", self.depth_unit)):
            if not (math.isfinite(number) and number > 0):
                raise InputError(option, str(number), "a positive number")
        if self.renderer == "thinlens" and not self.aperture_shape.is_disc:
            raise InputError("--renderer thinlens", f"--shape {self.shape}", "a disc, without obstruction")
        if self.renderer == "thinlens" and self.gamma != GAMMA:
            raise InputError("--renderer thinlens", f"--gamma {self.gamma:g}", f"{GAMMA}, as its scenes have")
        self._check_f_numbers()
        _ = self.aperture_shape, self.sensor, self.depth_source
        self._check_assignment()

    def _check_f_numbers(self) -> None:
        pair = (("--train-f-number", self.train_f_number), ("--test-f-number", self.test_f_number))
        for (option, value), (other, needed) in (pair, pair[::-1]):
            if value is None:
                continue
            if not (math.isfinite(value) and value > 0):
                raise InputError(option, str(value), "a positive number")
            if needed is None:
                raise InputError(option, f"no {other}", "both: photographs to train on, and others to test with")
            if value == needed:
                raise InputError(option, f"{value:g}, as {other}", "two f-numbers")
            if self.hold is not None:
                raise InputError(option, f"--hold {self.hold} too", "one of them: either says which views are held out")

    def _check_assignment(self) -> None:
        if self.assign != "held-out":
            for option, value in (("--test-focus", self.test_focus), ("--test-aperture", self.test_aperture)):
                if value is not None:
                    raise InputError(option, f"--assign {self.assign}", "--assign held-out, the only one that uses it")
        elif self.test_focus is None:
            raise InputError("--assign held-out", "no --test-focus", "focus values of the test views")
        elif shared := sorted(set(self.held_out_values.focus) & set(self.focus_values)):
            raise InputError("--test-focus", f"{shared[0]:g}, a training focus too", "values that no training view has")
        if self.assign == "continuous":
            for option, values in (("--focus", self.focus_values), ("--aperture", self.aperture_values)):
                if len(values) > 2:
                    raise InputError(
                        f"{option} with --assign continuous",
                        f"{len(values)} values",
                        "the two ends of a range, or one value",
                    )

    @property
    def depth_source(self) -> tuple[DepthSource, Path | None]:
        """The source's kind, and the folder of "folder" or the network of "onnx". Raises InputError for any other."""
        kind, _, place = self.depth.partition(":")
        if kind in ("folder", "onnx") and place:
            return kind, Path(place)
        if self.depth not in ("auto", "given", "splat", "sfm"):
            raise InputError("--depth", repr(self.depth), "auto, given, splat, sfm, onnx:FILE or folder:DIR")
        return self.depth, None

    @property
    def values(self) -> Values:
        """The focus and aperture values of the training views, and unless held out of the test views."""
        return Values(self.focus_values, self.aperture_values)

    @property
    def held_out_values(self) -> Values | None:
        """The test views' own values; None without --assign held-out. Raises InputError as `focus_values` does."""
        if self.assign != "held-out" or self.test_focus is None:
            return None
        if self.test_aperture is not None:
            aperture = _numbers("--test-aperture", self.test_aperture)
        else:
            aperture = (0.0, *(value for value in self.aperture_values if value > 0))
        return Values(_numbers("--test-focus", self.test_focus), aperture)

    @property
    def sensor(self) -> Sensor:
        """The sensor's noise. Raises InputError for a negative number."""
        for option, value in (("--photons", self.photons), ("--read-noise", self.read_noise)):
            if not (math.isfinite(value) and value >= 0):
                raise InputError(option, str(value), "0 or a positive number")
        return Sensor(self.photons, self.read_noise, self.seed)

    @property
    def focus_values(self) -> tuple[float, ...]:
        """The focus values, in the order given. Raises InputError for anything but distinct numbers in [0, 1]."""
        return _numbers("--focus", self.focus)

    @property
    def aperture_values(self) -> tuple[float, ...]:
        """The aperture values, in the order given. Raises InputError as `focus_values` does."""
        return _numbers("--aperture", self.aperture)

    @property
    def blur(self) -> Blur:
        """How the photographs are blurred, but for aperture and focus. Raises InputError for what doesn't exist."""
        shape = self.aperture_shape
        try:
            return Blur(self.gamma, self.alpha, shape, self.energy, self.renderer, self.layers)
        except InputError as error:
            raise InputError(f"--{error.subject}", error.found, error.expected) from None

    @property
    def aperture_shape(self) -> ApertureShape:
        """The shape that the four shape options describe. Raises InputError for an impossible one."""
        match = re.fullmatch(r"(\d+)-gon", self.shape)
        if self.shape != "disc" and match is None:
            raise InputError("--shape", repr(self.shape), "disc or N-gon, such as 5-gon")
        blades = int(match[1]) if match else 0
        if match and blades < 3:
            raise InputError("--shape", repr(self.shape), "a polygon with at least 3 corners")
        if not match and (self.shape_rotation or self.shape_curvature):
            raise InputError("--shape disc", "a rotation or a curvature", "neither, as a disc has no corners")
        if not math.isfinite(self.shape_rotation):
            raise InputError("--shape-rotation", str(self.shape_rotation), "degrees")
        if not 0 <= self.shape_curvature <= 1:
            raise InputError("--shape-curvature", str(self.shape_curvature), "0 to 1")
        if not 0 <= self.shape_obstruction < 1:
            raise InputError("--shape-obstruction", str(self.shape_obstruction), "0 to below 1")
        return ApertureShape(blades, math.radians(self.shape_rotation), self.shape_curvature, self.shape_obstruction)

    @property
    def _depth_name(self) -> str:
        # Where the folder or the network is doesn't decide the content: what is in it does; the identity holds that.
        kind, place = self.depth_source
        return kind if place is None else f"{kind}:{place.name}"

    def check_unblurred(self, scene: str) -> None:
        """Raise InputError for an option that says how to blur: the photographs of this scene are shallow already."""
        default = MakeDataset()
        for name in _BLURRING:
            given = getattr(self, name)
            if given != getattr(default, name):
                raise InputError(
                    f"--{name.replace('_', '-')}",
                    f"{given} for {scene}, whose photographs are shallow already",
                    "no option that says how to blur them, or how much",
                )
        if self.depth_source[0] not in ("auto", "given", "folder"):
            raise InputError(
                "--depth",
                f"{self.depth} for {scene}, whose photographs are shallow already",
                "given, folder:DIR or auto: what is known, no estimate",
            )

    def photograph_recipe(self) -> dict[str, object]:
        """Of `recipe`, what decides a dataset of photographs that are shallow already."""
        names = ("width", "hold", "depth", "depth_unit", "images", "layout")
        return {name: self.recipe()[name] for name in names} | {"photographs": self.photographs} | self._f_numbers

    @property
    def _f_numbers(self) -> dict[str, object]:
        if self.train_f_number is None:
            return {}
        return {
            "train_f_number": self.train_f_number,
            "test_f_number": self.test_f_number,
            "test_points": self.test_points,
        }

    def recipe(self) -> dict[str, object]:
        """Everything that decides the dataset's content, as plain data: no path, nothing of this machine."""
        return {
            "focus": list(self.focus_values),
            "aperture": list(self.aperture_values),
            "width": self.width,
            "hold": self.hold,
            "depth": self._depth_name,
            "depth_unit": self.depth_unit,
            "depth_steps": self.depth_steps,
            "gamma": self.gamma,
            "alpha": self.alpha,
            "shape": self.shape,
            "shape_rotation": self.shape_rotation,
            "shape_curvature": self.shape_curvature,
            "shape_obstruction": self.shape_obstruction,
            "energy": self.energy,
            "renderer": self.renderer,
            "layers": self.layers,
            "lens_samples": self.lens_samples,
            "normaliser": self.normaliser,
            "assign": self.assign,
            "test_focus": _listed(self.held_out_values, "focus"),
            "test_aperture": _listed(self.held_out_values, "aperture"),
            "photons": self.photons,
            "read_noise": self.read_noise,
            "bits": self.bits,
            "linear": self.linear,
            "seed": self.seed,
            "images": self.images,
            "layout": self.layout,
            # Absent from the datasets of all-in-focus scenes, whose recipe was there first.
            **({} if self.photographs == "auto" else {"photographs": self.photographs}),
            **self._f_numbers,
        }

    def command(self, scene_name: str) -> str:
        """The command line that makes this dataset, with the scene called by its name."""
        words = ["dofbench make-dataset", scene_name]
        default = MakeDataset().recipe()
        for key, value in self.recipe().items():
            if value != default.get(key):
                text = ",".join(f"{number:g}" for number in value) if isinstance(value, list) else str(value)
                words.append(f"--{key.replace('_', '-')} {text}")
        return " ".join(words)


@dataclass(frozen=True)
class MakeDataset(DatasetOptions):
    """One shallow depth-of-field dataset: its lens is known where the scene is all in focus, unknown where it isn't."""

    scene: str | None = None
    """As one of `MakeDatasets.scenes`."""

    def __post_init__(self) -> None:
        lenses = len(self.focus_values), len(self.aperture_values)
        if self.assign == "fixed" and lenses != (1, 1):
            raise InputError("--assign fixed", f"{lenses[0]} focus and {lenses[1]} aperture values", "one of each")
        super().__post_init__()


@dataclass(frozen=True)
class MakeDatasets(DatasetOptions):
    """Make shallow depth-of-field datasets whose lens is known from all-in-focus scenes, or of photographs that are
    shallow already, by a lens that nobody knows."""

    scenes: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Scene folders in any supported layout, built-in scenes, scenes of named datasets, such as llff/fern, or named
    datasets, which mean all their scenes; without any, the built-in scene."""

    jobs: int | None = None
    """Datasets to make at the same time, each in a process of its own; without it, one for each core."""

    like: Path | None = None
    """Make again what a dataset's dataset.json describes, and compare every byte: its options hold, SCENE says where
    its scene is, --out where to."""

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise InputError("--jobs", str(self.jobs), "at least 1")
        super().__post_init__()

    def lenses(self) -> tuple[tuple[str, float, float] | None, ...]:
        """(name, focus, aperture) of every lens of --assign fixed, which makes a dataset of each; else one None."""
        if self.assign != "fixed":
            return (None,)
        return tuple(
            (f"F{focus:g}-A{aperture:g}", focus, aperture)
            for focus in self.focus_values
            for aperture in self.aperture_values
        )

    def one(self, scene: str | None, out: Path, lens: tuple[str, float, float] | None) -> MakeDataset:
        """The settings of one of the datasets: of a scene, for a folder, by one of `lenses`."""
        options = {field.name: getattr(self, field.name) for field in fields(DatasetOptions)}
        if lens is not None:
            options |= {"focus": repr(lens[1]), "aperture": repr(lens[2])}
        return MakeDataset(**options | {"scene": scene, "out": out})


def _listed(values: Values | None, name: str) -> list[float] | None:
    return None if values is None else list(getattr(values, name))


def _numbers(option: str, text: str) -> tuple[float, ...]:
    entries = [entry.strip() for entry in text.split(",")]
    values = []
    for entry in entries:
        try:
            value = float(entry)
        except ValueError:
            raise InputError(option, repr(text), "numbers separated by commas, such as 0.2,0.5") from None
        if not 0 <= value <= 1:  # also catches NaN
            raise InputError(option, entry, "numbers from 0 to 1")
        values.append(value)
    if len(set(values)) < len(values):
        raise InputError(option, repr(text), "every value once")
    return tuple(values)
