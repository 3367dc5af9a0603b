"""A depth network in ONNX, and the side file that describes its input and output."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import resize
from dofbench.core.readable import read_toml

Preset = Literal["depth-pro", "depth-anything-v2", "midas"]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

_EXPECTED = 'a description of the network, such as preset = "midas"'
_IMAGENET = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
# What the published networks ask for. A side file's own values win over its preset's.
PRESETS: dict[str, dict[str, Any]] = {
    # apple/ml-depth-pro, src/depth_pro/depth_pro.py: the transform and `infer` resize to 1536 x 1536 and normalise by
    # 0.5; `forward` gives canonical inverse depth, which a factor (width / focal length) makes metric. What was
    # exported from `infer` gives depth: output = "depth".
    "depth-pro": {
        "size": (1536, 1536),
        "mean": (0.5, 0.5, 0.5),
        "std": (0.5, 0.5, 0.5),
        "output": "disparity",
        "align": "scale",
    },
    # DepthAnything/Depth-Anything-V2, depth_anything_v2/dpt.py, image2tensor: shorter side 518, multiples of 14. Its
    # metric versions give depth: output = "depth", align = "scale".
    "depth-anything-v2": {"shortest": 518, "multiple": 14, **_IMAGENET, "output": "disparity", "align": "scale-shift"},
    # isl-org/MiDaS, hubconf.py, default_transform (v2.1): longer side 384, multiples of 32. Its DPT versions normalise
    # by 0.5; ONNX files made by its tf/make_onnx_model.py normalise inside: mean = [0, 0, 0], std = [1, 1, 1].
    "midas": {"longest": 384, "multiple": 32, **_IMAGENET, "output": "disparity", "align": "scale-shift"},
}


class Description(BaseModel):
    """The side file NETWORK.onnx.toml, with exactly one of size, shortest and longest, or a preset's.

    size: (width, height), pixels. shortest, longest: pixels of that side, the aspect ratio kept but for rounding to
    `multiple`. mean, std: by channel, after scaling to 0 ... full_scale. output: disparity (larger is nearer) or depth.
    align: fitted to the sparse points; none for output in scene units. tensor: the output's name, where there are
    several maps.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = ""
    preset: Preset | None = None
    size: tuple[Annotated[int, Field(ge=8)], Annotated[int, Field(ge=8)]] | None = None
    shortest: int | None = Field(default=None, ge=8)
    longest: int | None = Field(default=None, ge=8)
    multiple: int = Field(default=1, ge=1)
    mean: Triple = (0.0, 0.0, 0.0)
    std: Triple = (1.0, 1.0, 1.0)
    full_scale: FiniteFloat = Field(default=1.0, gt=0)
    colour: Literal["rgb", "bgr"] = "rgb"
    output: Literal["disparity", "depth"]
    align: Literal["scale-shift", "scale", "none"] = "scale-shift"
    tensor: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or values.get("preset") not in PRESETS:
            return values
        sizes = {"size", "shortest", "longest"}
        preset = PRESETS[str(values["preset"])]
        if sizes & values.keys():
            preset = {key: value for key, value in preset.items() if key not in sizes}
        return {**preset, **values}

    @model_validator(mode="after")
    def _possible(self) -> Description:
        if sum(value is not None for value in (self.size, self.shortest, self.longest)) != 1:
            raise ValueError("expected exactly one of size, shortest and longest")
        if 0 in self.std:
            raise ValueError("expected std without a 0")
        return self

    def input_size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) that an image of that size is resized to."""
        if self.size is not None:
            return self.size
        if self.shortest is not None:
            scale = self.shortest / min(width, height)
        else:
            scale = (self.longest or 0) / max(width, height)
        whole = [max(self.multiple, round(side * scale / self.multiple) * self.multiple) for side in (width, height)]
        return whole[0], whole[1]


def find_network(name: str) -> Path:
    """The file of NAME in `onnx:NAME`: a path, or a network shipped with dofbench. Raises InputError."""
    shipped = content_folder("datasets") / name / f"{name}.onnx"
    if Path(name).is_file():
        return Path(name)
    if Path(name).name == name and shipped.is_file():
        return shipped
    raise InputError(name, "no such file and no shipped network of that name", "an ONNX network, or depthnet")


def side_file(network: Path) -> Path:
    """The path of a network's description, NETWORK.onnx.toml next to it."""
    return network.with_name(f"{network.name}.toml")


def network_digest(network: Path) -> dict[str, str]:
    """sha256 of a network and its side file. Raises InputError when that is missing."""
    beside = side_file(network)
    if not beside.is_file():
        raise InputError(beside, "no such file", _EXPECTED)
    return {"name": network.name, "sha256": sha256_file(network), "description_sha256": sha256_file(beside)}


def read_description(network: Path) -> Description:
    """Read the side file of a network. Raises InputError, one line, when it is missing or wrong."""
    path = side_file(network)
    values = read_toml(path, _EXPECTED)
    try:
        return Description.model_validate(values)
    except ValidationError as error:
        found = [(".".join(map(str, problem["loc"])) or "file", problem["msg"]) for problem in error.errors()]
        problems = "; ".join(f"{place}: {message.removeprefix('Value error, ')}" for place, message in found)
        raise InputError(path, problems, _EXPECTED) from None


class Network:
    """A loaded network: image in, map out."""

    def __init__(self, file: Path):
        """Raises InputError for a file, or a side file, that can't be used."""
        # Imported here because onnxruntime takes long to load and only this function needs it.
        import onnxruntime

        self.file, self.description = file, read_description(file)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = int(os.environ.get("OMP_NUM_THREADS", "0").split(",")[0] or 0)
        options.log_severity_level = 4  # fatal only: errors are raised as exceptions, and reported in one line below
        try:
            self._session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions have no other common base class
            raise InputError(file, f"no readable network ({_first_line(error)})", "an ONNX network") from None
        inputs = self._session.get_inputs()
        if (
            len(inputs) != 1
            or len(inputs[0].shape) != 4
            or (inputs[0].shape[1] not in (3, None) and not isinstance(inputs[0].shape[1], str))
        ):
            found = ", ".join(f"{entry.name} {entry.shape}" for entry in inputs)
            raise InputError(file, f"inputs {found}", "one input (1, 3, height, width)")
        if inputs[0].type not in ("tensor(float)", "tensor(float16)"):
            raise InputError(file, f"an input of {inputs[0].type}", "one of float or float16")
        self._input = inputs[0]
        names = [entry.name for entry in self._session.get_outputs()]
        if self.description.tensor is not None and self.description.tensor not in names:
            raise InputError(side_file(file), f"tensor {self.description.tensor!r}", f"one of {', '.join(names)}")
        self._names = names if self.description.tensor is None else [self.description.tensor]

    def predict(self, image: np.ndarray, view: str) -> np.ndarray:
        """The network's map (h, w) float32, at its own size, of an encoded image (H, W, 3) float32.

        view: its name, for messages. Raises InputError when the network fails, gives no map or several, or values that
        are not finite.
        """
        prepared = self._prepared(image)
        try:
            outputs = self._session.run(self._names, {self._input.name: prepared})
        except Exception as error:
            found = f"a failure on view {view}, {prepared.shape[3]}x{prepared.shape[2]} pixels ({_first_line(error)})"
            raise InputError(self.file, found, f"a network that takes what {side_file(self.file).name} says") from None
        maps = [np.squeeze(output) for output in outputs]
        maps = [one for one in maps if one.ndim == 2 and min(one.shape) > 1]
        if len(maps) != 1:
            shapes = ", ".join(f"{name} {output.shape}" for name, output in zip(self._names, outputs, strict=True))
            named = f"one map: name it, tensor = ... in {side_file(self.file)}"
            expected = named if maps else "one map (height, width)"
            raise InputError(self.file, f"outputs {shapes} for view {view}", expected)
        values = maps[0].astype(np.float32)
        bad = int((~np.isfinite(values)).sum())
        if bad:
            raise InputError(self.file, f"{bad} values that are not finite for view {view}", "finite values")
        return values

    def _prepared(self, image: np.ndarray) -> np.ndarray:
        """(1, 3, height, width) as the description says; where the network's own size is fixed, at that."""
        wanted = self.description.input_size(image.shape[1], image.shape[0])
        fixed = self._input.shape[3], self._input.shape[2]
        for own, asked, side in zip(fixed, wanted, ("wide", "high"), strict=True):
            if self.description.size is not None and isinstance(own, int) and own != asked:
                raise InputError(side_file(self.file), f"size with {asked} pixels", f"{own}, as the network is {side}")
        width, height = (own if isinstance(own, int) else asked for own, asked in zip(fixed, wanted, strict=True))
        small = np.clip(resize(np.ascontiguousarray(image, dtype=np.float32), width, height), 0, 1)
        if self.description.colour == "bgr":
            small = small[..., ::-1]
        small = (small * self.description.full_scale - np.array(self.description.mean)) / np.array(self.description.std)
        kind = np.float16 if self._input.type == "tensor(float16)" else np.float32
        return np.ascontiguousarray(small.transpose(2, 0, 1)[None], dtype=kind)


def sampled(values: np.ndarray, xy: np.ndarray, width: int, height: int) -> np.ndarray:
    """Bilinear samples (M,) float64 of a map (h, w) at image coordinates (M, 2) of an image `width` x `height`."""
    scale = np.array([values.shape[1] / width, values.shape[0] / height])
    x, y = (np.clip(at, 0, side - 1) for at, side in zip((xy * scale - 0.5).T, values.shape[::-1], strict=True))
    left, top = (np.minimum(at.astype(int), side - 2) for at, side in zip((x, y), values.shape[::-1], strict=True))
    x, y = x - left, y - top
    values = values.astype(np.float64)
    upper = values[top, left] * (1 - x) + values[top, left + 1] * x
    lower = values[top + 1, left] * (1 - x) + values[top + 1, left + 1] * x
    return upper * (1 - y) + lower * y


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
