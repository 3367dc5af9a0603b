"""The options of `make-dataset`, their checks, and the values derived from them."""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import Field, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from pydantic import Field as Bounds

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, GAMMA, LAYERS, ApertureShape, Energy, SceneRenderer
from dofbench.core.options import NumberList, flag, given, options, spelled
from dofbench.datasets.format.assignment import Assign
from dofbench.datasets.format.points_choice import Points
from dofbench.datasets.format.sensor import Sensor
from dofbench.datasets.synthesis.lens_plan import Values
from dofbench.runtime.executors import WhereOptions
from dofbench.scenes.scene import Alpha

DepthSource = Literal["auto", "given", "folder", "splat", "sfm", "onnx"]
_WITH_PLACE: tuple[DepthSource, ...] = ("folder", "onnx")
_WITHOUT_PLACE: tuple[DepthSource, ...] = ("auto", "given", "splat", "sfm")
Normaliser = Literal["scene", "view"]
Bits = Literal[8, 16]
Photographs = Literal["auto", "shallow", "shallow-train", "light-field"]
LinearFormat = Literal["exr-half", "exr-float"]


# What an option is about. scene: what is read from a scene. blur: how sharp images become shallow photographs; these
# options aren't allowed for photographs that are shallow already. seed: random choices, which don't affect such
# photographs. place: locations on this machine, which don't affect the content.
About = Literal["scene", "blur", "seed", "place"]

Share = Annotated[float, Bounds(ge=0, le=1)]


_APERTURES = (0.5, 1.0)


def _option(
    default: Any, about: About, *, sharp: bool = False, kept_with: str | None = None, light_field: bool = False
) -> Any:
    metadata = {"about": about, "sharp": sharp, "kept_with": kept_with, "light_field": light_field}
    return field(default=default, metadata=metadata)


@options()
class DatasetOptions:
    """The options that making one dataset and making several have in common.

    Each field says what it is about (`About`). sharp: the sharp images and the depth depend on the option. kept_with:
    the option is part of the recipe only if this other option is set, so that older datasets keep their recipes.
    light_field: the option applies to `--photographs light-field`.
    """

    data_root: Path | None = _option(None, "place")
    """Folder that holds named datasets (`dofbench scenes` lists them); without it, the one in DOFBENCH_DATA."""

    focus: NumberList[Share] = _option((0.2, 0.5, 0.8), "blur", light_field=True)
    """Focus values, comma-separated: normalised disparity, 0 far to 1 near."""

    aperture: NumberList[Share] | None = _option(None, "blur", light_field=True)
    """Aperture values, comma-separated: 1 blurs by 2 % of the width per unit of disparity, 0 not at all. Without it:
    0.5,1; of a light field, windows of half and a quarter of its steps from the centre to the border."""

    width: Annotated[int, Bounds(ge=8)] | None = _option(None, "scene", sharp=True, light_field=True)
    """Image width in pixels; without it, a named dataset's usual one, else the scene's own."""

    hold: Annotated[int, Bounds(ge=2)] | None = _option(None, "scene", sharp=True, light_field=True)
    """Every hold-th view, from the first, is a test view; without it, the named dataset's or the scene's own split (as
    in test.txt or transforms.json), or 8."""

    depth: str = _option("auto", "scene", sharp=True)
    """Where depth comes from: the scene (given), maps of z-depth in a folder (folder:DIR), a reconstruction (splat),
    its sparse points (sfm), a monocular network aligned to them (onnx:FILE with FILE.toml beside it, or the shipped
    onnx:depthnet), or given if there is any, else splat (auto)."""

    depth_unit: Annotated[float, Bounds(gt=0)] = _option(1.0, "scene", sharp=True)
    """Scene units per unit of the maps of --depth folder:DIR."""

    depth_steps: Annotated[int, Bounds(ge=1)] = _option(3000, "blur", sharp=True)
    """Training steps of the reconstruction behind --depth splat."""

    gamma: float = _option(GAMMA, "blur", light_field=True)
    """Display encoding: linear light is the encoded image to this power."""

    alpha: float = _option(ALPHA, "blur")
    """Steepness of the blur disc's edge, per pixel."""

    shape: str = _option("disc", "blur")
    """Aperture shape: disc, or N-gon with N blades, such as 5-gon."""

    shape_rotation: float = _option(0.0, "blur")
    """Direction of the polygon's first corner, degrees from right towards down."""

    shape_curvature: float = _option(0.0, "blur")
    """How far the polygon's blades bulge: 0 straight to 1 a disc."""

    shape_obstruction: float = _option(0.0, "blur")
    """Radius of a central stop as a share of the aperture's, 0 to below 1."""

    energy: Energy = _option("area", "blur")
    """Scatter weight: divided by the disc's area, or as printed in the paper's Algorithm 1."""

    renderer: SceneRenderer = _option("scatter", "blur")
    """scatter: as in the paper, without occlusion; layered: depth layers composited from back to front; thinlens:
    rendered again through a real lens with mitsuba, for scenes made by make-scene."""

    layers: int = _option(LAYERS, "blur")
    """Depth layers of --renderer layered."""

    lens_samples: Annotated[int, Bounds(ge=2)] = _option(4096, "blur")
    """Rays per pixel of --renderer thinlens, each through its own lens point."""

    normaliser: Normaliser = _option("scene", "blur")
    """The disparity range that focus and aperture refer to: one for the scene, or one for every view."""

    assign: Assign = _option("per-view", "blur", light_field=True)
    """How views get their lenses: per-view, the grid of focus and aperture values is distributed over the views; fixed,
    all views have one lens, and a dataset is made for each lens of the grid; held-out, the test views have a grid of
    their own; continuous, lenses are drawn from the ranges that the values span."""

    test_focus: NumberList[Share] | None = _option(None, "blur", light_field=True)
    """Focus values of the test views for --assign held-out; they must differ from those of the training views."""

    test_aperture: NumberList[Share] | None = _option(None, "blur", light_field=True)
    """Aperture values of the test views for --assign held-out; without it, 0 and the training views'."""

    photons: Annotated[float, Bounds(ge=0)] = _option(0.0, "blur")
    """Shot noise: photons that a pixel at full scale collects, 0 for no such noise."""

    read_noise: Annotated[float, Bounds(ge=0)] = _option(0.0, "blur")
    """Read noise: standard deviation in linear light whose full scale is 1."""

    bits: Bits = _option(8, "blur", light_field=True)
    """Bits per channel of the photographs that methods train on."""

    linear: LinearFormat = _option("exr-half", "blur", light_field=True)
    """Format of the images before encoding."""

    seed: Annotated[int, Bounds(ge=0)] = _option(0, "seed", sharp=True, light_field=True)
    """Seed of the assignment of lenses, and of the reconstruction."""

    images: str | None = _option(None, "scene", sharp=True)
    """Folder of images inside the scene; without it, the layout's usual folder."""

    layout: str = _option("auto", "scene", sharp=True)
    """Layout of the scene folder: nerfstudio, llff, colmap, dofnerf, deblurnerf, or auto to detect it. This option
    decides if a folder has several layouts; auto ignores a transforms.json whose frame differs from that of the COLMAP
    model beside it."""

    alpha_channel: Alpha | None = _option(None, "scene", sharp=True, kept_with="alpha_channel")
    """What an alpha channel of the images means: mask, transparent pixels are neither trained on nor scored; or
    background, they are composited over black. Without it: mask, with a note."""

    skip_missing: bool = _option(False, "scene", sharp=True, kept_with="skip_missing")
    """Skip poses whose image files are missing, such as photographs that were deleted after structure from motion, and
    name them; without it, they are an error."""

    points: Points = _option("scene", "scene", kept_with="points", light_field=True)
    """Where the points come from that a method gets: the scene's own (scene); or, by the given poses, triangulated
    between the photographs of the training views alone, as they are before (sharp) or after (shallow) the blur. Depth,
    lenses and photographs are the same with all three. Of a light field, which has no points: shallow, unless sharp."""

    photographs: Photographs = _option("auto", "scene", kept_with="photographs", light_field=True)
    """Whether the scene's photographs are shallow already, by an unknown lens: auto, as the layout implies; shallow,
    all of them; shallow-train, the training photographs, while the test photographs are sharp. Such photographs aren't
    blurred, and unknown properties are omitted from the dataset. light-field: photographs are averages of the views in
    round windows of a light field (grid.json and views/RR_CC images), so real defocus by known lenses."""

    spacing: Annotated[int, Bounds(ge=1)] | None = _option(None, "scene", kept_with="spacing", light_field=True)
    """Grid steps between neighbouring views of a dataset from a light field; without it, 2."""

    train_f_number: Annotated[float, Bounds(gt=0)] | None = _option(None, "scene", kept_with="train_f_number")
    """Train only on the photographs taken at this f-number, by their EXIF; together with --test-f-number. For
    photographs that are shallow already."""

    test_f_number: Annotated[float, Bounds(gt=0)] | None = _option(None, "scene", kept_with="train_f_number")
    """Test with the photographs of this f-number, and exclude those of any other: the score is how well the learned
    aperture, scaled by the ratio of the two, predicts them."""

    test_points: Annotated[int, Bounds(ge=0)] = _option(100, "scene", kept_with="train_f_number")
    """With --test-f-number: exclude test photographs that share fewer sparse points with the training photographs,
    because surfaces that no training photograph saw tell nothing about the aperture."""

    coverage: bool = _option(False, "scene", kept_with="coverage")
    """Of photographs of unknown lens: train on every second test photograph as well. Next to the dataset without this,
    the scores of the other half say what more coverage gains."""

    reuse: Path | None = _option(None, "place")
    """A finished dataset that differs in --points alone: its images and depth are copied instead of made again."""

    out: Path | None = _option(None, "place")
    """Folder to write, or with several datasets the folder that contains them all; without it, data/<scene name>."""

    def __post_init__(self) -> None:
        self._check_lenses()
        _ = self.blur, self.depth_source
        if self.renderer == "thinlens":
            self._check_thin_lens()
        self._check_f_numbers()

    def _check_lenses(self) -> None:
        for name in ("test_focus", "test_aperture"):
            if given(self, name) and self.assign != "held-out":
                only = "--assign held-out, the only one that uses it"
                raise InputError(flag(name), f"--assign {self.assign}", only)
        if self.assign == "held-out" and self.test_focus is None:
            raise InputError("--assign held-out", "no --test-focus", "focus values of the test views")
        if self.test_focus is not None and (shared := sorted(set(self.test_focus) & set(self.focus))):
            raise InputError("--test-focus", f"{shared[0]:g}, a training focus too", "values that no training view has")
        for name in ("focus", "aperture") if self.assign == "continuous" else ():
            if (count := len(getattr(self.values, name))) > 2:
                ends = "the two ends of a range, or one value"
                raise InputError(f"{flag(name)} with --assign continuous", f"{count} values", ends)

    def _check_thin_lens(self) -> None:
        subject = "--renderer thinlens"
        if given(self, "gamma"):
            raise InputError(subject, f"--gamma {self.gamma:g}", f"{GAMMA}, as its scenes have")
        if not self.aperture_shape.is_disc:  # a polygon whose blades are curved to a full disc is one
            name = "shape" if given(self, "shape") else "shape_obstruction"
            raise InputError(subject, f"{flag(name)} {getattr(self, name)}", "a disc, without obstruction")

    def _check_f_numbers(self) -> None:
        for name, other in (("train_f_number", "test_f_number"), ("test_f_number", "train_f_number")):
            if getattr(self, name) is None:
                continue
            if getattr(self, other) is None:
                both = "both: photographs to train on, and others to test with"
                raise InputError(flag(name), f"no {flag(other)}", both)
            if self.hold is not None:
                one = "one of them: either says which views are held out"
                raise InputError(flag(name), f"--hold {self.hold} too", one)
        if self.train_f_number is not None and self.train_f_number == self.test_f_number:
            raise InputError("--train-f-number", f"{self.train_f_number:g}, as --test-f-number", "two f-numbers")

    @property
    def depth_source(self) -> tuple[DepthSource, Path | None]:
        """The source's kind, and the folder of "folder" or the network of "onnx". Raises InputError for any other
        value."""
        kind, _, place = self.depth.partition(":")
        for source in _WITH_PLACE:
            if kind == source and place:
                return source, Path(place)
        for source in _WITHOUT_PLACE:
            if self.depth == source:
                return source, None
        raise InputError("--depth", repr(self.depth), "auto, given, splat, sfm, onnx:FILE or folder:DIR")

    @property
    def values(self) -> Values:
        """The focus and aperture values of the training views; also of the test views, unless --assign is held-out."""
        return Values(self.focus, _APERTURES if self.aperture is None else self.aperture)

    @property
    def held_out_values(self) -> Values | None:
        """The test views' own values; None without --assign held-out."""
        if self.test_focus is None:
            return None
        if self.test_aperture is not None:
            return Values(self.test_focus, self.test_aperture)
        return Values(self.test_focus, (0.0, *(value for value in self.values.aperture if value > 0)))

    @property
    def sensor(self) -> Sensor:
        """The sensor's noise."""
        return Sensor(self.photons, self.read_noise, self.seed)

    @property
    def blur(self) -> Blur:
        """How the photographs are blurred: all settings except aperture and focus. Raises InputError for impossible
        settings."""
        shape = self.aperture_shape
        try:
            renderer = "light-field" if self.photographs == "light-field" else self.renderer
            return Blur(self.gamma, self.alpha, shape, self.energy, renderer, self.layers)
        except InputError as error:
            raise _typed(error) from None

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
        rotation = math.radians(self.shape_rotation)
        try:
            return ApertureShape(blades, rotation, self.shape_curvature, self.shape_obstruction)
        except InputError as error:
            raise _typed(error) from None

    def check_unblurred(self, scene: str) -> None:
        """Raise InputError if an option about blur is given, since the photographs of this scene are shallow
        already."""
        for at in fields(DatasetOptions):
            if at.metadata["about"] == "blur" and given(self, at.name):
                value = getattr(self, at.name)
                raise InputError(
                    flag(at.name),
                    f"{spelled(value) if isinstance(value, tuple) else value} for {scene}, whose photographs are "
                    "shallow already",
                    "no option that says how to blur them, or how much",
                )
        if self.points == "sharp":
            found = f"sharp for {scene}, whose photographs are shallow already"
            raise InputError("--points", found, "scene or shallow")
        if self.reuse is not None:
            found = f"a dataset for {scene}, whose photographs are shallow already"
            raise InputError("--reuse", found, "none, as nothing is blurred")
        if self.depth_source[0] not in ("auto", "given", "folder"):
            raise InputError(
                "--depth",
                f"{self.depth} for {scene}, whose photographs are shallow already",
                "given, folder:DIR or auto: what is known, no estimate",
            )

    def check_light_field(self, scene: str) -> None:
        """Raise InputError if an option is given that doesn't apply to a light field, whose views are averaged."""
        for at in fields(DatasetOptions):
            if at.metadata["about"] != "place" and not at.metadata["light_field"] and given(self, at.name):
                raise InputError(
                    flag(at.name),
                    f"{getattr(self, at.name)} for {scene}, a light field",
                    "no such option: its photographs are averages of its views",
                )

    def recipe(self) -> dict[str, object]:
        """All settings that decide the dataset's content, as plain data without paths or other properties of this
        machine."""
        kept = (at for at in fields(DatasetOptions) if at.metadata["about"] != "place" and self._is_kept(at))
        return {at.name: self._plain(at.name) for at in kept}

    def photograph_recipe(self) -> dict[str, object]:
        """The part of `recipe` that decides a dataset of photographs that are shallow already, with the option that
        says so."""
        about_scene = (at for at in fields(DatasetOptions) if at.metadata["about"] == "scene")
        return {at.name: self._plain(at.name) for at in about_scene if at.name == "photographs" or self._is_kept(at)}

    def _is_kept(self, at: Field[Any]) -> bool:
        if self.photographs == "light-field" and not at.metadata["light_field"]:
            return False
        other = at.metadata.get("kept_with")
        return other is None or given(self, other)

    def _plain(self, name: str) -> object:
        if name == "depth":
            # The path of the folder or network is omitted, because its content matters; the identity has the content's
            # hash.
            kind, place = self.depth_source
            return kind if place is None else f"{kind}:{place.name}"
        if name == "aperture":
            return list(self.values.aperture)
        if name in ("test_focus", "test_aperture"):
            held_out = self.held_out_values
            return None if held_out is None else list(getattr(held_out, name.removeprefix("test_")))
        value = getattr(self, name)
        return list(value) if isinstance(value, tuple) else value

    def command(self, scene_name: str) -> str:
        """The command line that makes this dataset, with the scene's name in place of its path."""
        words = ["dofbench", "make-dataset", scene_name]
        default = MakeDataset().recipe()
        if self.photographs == "light-field":  # whose default aperture depends on the grid
            del default["aperture"]
        for key, value in self.recipe().items():
            if value is True:
                words.append(flag(key))
            elif value != default.get(key):
                words += [flag(key), spelled(value) if isinstance(value, list) else str(value)]
        return shlex.join(words)


@options()
class MakeDataset(DatasetOptions):
    """One shallow depth-of-field dataset. The lens is known if the scene is all in focus, else unknown."""

    scene: str | None = None
    """The scene, in the form of an element of `MakeDatasets.scenes`."""

    def __post_init__(self) -> None:
        lenses = len(self.focus), len(self.values.aperture)
        if self.assign == "fixed" and lenses != (1, 1):
            raise InputError("--assign fixed", f"{lenses[0]} focus and {lenses[1]} aperture values", "one of each")
        super().__post_init__()


@options()
class MakeDatasets(WhereOptions, DatasetOptions):
    """Make shallow depth-of-field datasets: from all-in-focus scenes with a known lens, or from photographs that are
    shallow already, whose lens is unknown."""

    scenes: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Scene folders in any supported layout, built-in scenes, scenes of named datasets, such as llff/fern, or names of
    datasets for all their scenes; without any, the built-in scene."""

    jobs: Annotated[int, Bounds(ge=1)] | None = None
    """Datasets to make at the same time, each in a process of its own; without it, one for each core."""

    like: Path | None = None
    """A dataset.json: make the dataset that it describes again, with its options, and compare every byte. SCENE says
    where the scene is, --out where to write."""

    def lenses(self) -> tuple[tuple[str, float, float] | None, ...]:
        """(name, focus, aperture) of every lens of --assign fixed, each of which gets a dataset; without fixed, a
        single None."""
        if self.assign != "fixed":
            return (None,)
        return tuple(
            (f"F{focus:g}-A{aperture:g}", focus, aperture) for focus in self.focus for aperture in self.values.aperture
        )

    def one(self, scene: str | None, out: Path, lens: tuple[str, float, float] | None) -> MakeDataset:
        """The settings of one dataset: its scene, its folder, and one of `lenses`."""
        options = {field.name: getattr(self, field.name) for field in fields(DatasetOptions)}
        if lens is not None:
            options |= {"focus": (lens[1],), "aperture": (lens[2],)}
        return MakeDataset(**options | {"scene": scene, "out": out})


def _typed(error: InputError) -> InputError:
    """The error about a value, changed to name the option that gave the value."""
    return InputError(f"--{error.subject.replace(' ', '-')}", error.found, error.expected)
