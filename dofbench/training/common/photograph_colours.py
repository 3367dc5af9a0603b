"""Exposure and white balance of every training photograph, learned together with the scene.

A photograph is the rendering c through its lens, changed by a colour transform of its own. Exposure and white balance
are a factor per channel in linear light. Encoded values are a power of linear light, so they are a factor per channel
of encoded values too: "gain", exp(g) c. "affine" is (1 + D) c + e, which can also model mixing of channels, a veil of
stray light and, roughly, another tone curve.

Multiplying the scene's colours by a factor and dividing every photograph's transform by it gives the same photographs.
This ambiguity is removed after every step by making the mean of g, or of D and e, over the photographs zero. So the
scene has the photographs' mean colour, in which new views are rendered, and photographs of equal colour get no
transform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.runtime.ops import load
from dofbench.training.common.row_adam import RowAdam

_COLUMNS = {"off": 0, "gain": 3, "affine": 12}
FILE, SCHEMA, VERSION = "colours.json", "dofbench.colours", 1
CONVENTION = "photograph = matrix[:, :3] @ rendering through the lens + matrix[:, 3], encoded colours in [0, 1]"


@dataclass(frozen=True)
class ColourOptions:
    """Which colour transform is learned for each photograph, and how fast."""

    colour_per_view: Literal["off", "gain", "affine"] = "off"
    """Colour transform learned for every photograph: off; gain, a factor per channel; affine, a matrix and an offset.
    Unit: none. Source: own."""
    colour_lr: float = 1e-2
    """Adam's learning rate of the colour transforms at the start. Unit: parameter, a step. Source: own."""
    colour_lr_fall: float = 0.1
    """Factor on colour_lr that is reached at the end; the rate falls exponentially in between. Unit: none. Source:
    own."""


class LearnedColours:
    """A colour transform for each photograph, starting from identity: `colour_per_view` "gain" or "affine"; with "off"
    none is learned."""

    def __init__(self, count: int, options: ColourOptions, device: torch.device | str = "cpu"):
        self._options = options
        self._kind = options.colour_per_view
        self._table = RowAdam(torch.zeros(count, _COLUMNS[self._kind], device=device))

    @property
    def learned(self) -> bool:
        """Whether colour transforms are learned."""
        return self._kind != "off"

    def forward(self, view: int, image: Tensor) -> Tensor:
        """The image (H, W, 3) with the colour transform of photograph number `view`; differentiable with respect to
        both."""
        return self._applied(self._table.leaf(view), image) if self.learned else image

    def of_pixels(self, views: Tensor, colours: Tensor) -> Tensor:
        """Colours (..., P, 3) of pixels, each with the transform of the photograph that it is of, numbered by views
        (P,) int64; differentiable with respect to both."""
        if not self.learned:
            return colours
        # Looked up as an embedding since its gradient is added up in the same order every time, on a GPU too.
        raw = torch.nn.functional.embedding(views, self._table.leaf(None))
        if self._kind == "gain":
            return colours * raw.exp()
        change = raw.view(-1, 3, 4)
        return colours + (change[:, :, :3] @ colours[..., None])[..., 0] + change[:, :, 3]

    def gradient(self) -> Tensor | None:
        """Gradient with respect to the raw parameters of the view of the last `forward`, or of all after `of_pixels`;
        None if nothing is learned."""
        return self._table.gradient

    def step(self, view: int | None, progress: float, cooldown: float = 1.0) -> None:
        """One Adam step on a view's colour transform after `forward`, on all after `of_pixels` (None), its rate times
        `cooldown`; then the mean over the views is made zero again."""
        if not self.learned:
            return
        options = self._options
        rate = options.colour_lr * options.colour_lr_fall**progress * cooldown
        self._table.step(view, rate)
        self._table.values -= self._table.values.mean(dim=0)

    @torch.no_grad()
    def apply(self, view: int, image: Tensor) -> Tensor:
        """The image as `forward` gives it, without gradient."""
        return self._applied(self._table.values[view], image)

    def matrix(self, view: int) -> np.ndarray:
        """(3, 4) float32, a photograph's colour transform: [M | e] of M c + e."""
        raw = self._table.values[view].numpy(force=True)
        match self._kind:
            case "off":
                return np.eye(3, 4, dtype=np.float32)
            case "gain":
                return np.diag(np.exp(raw)) @ np.eye(3, 4, dtype=np.float32)
        return np.eye(3, 4, dtype=np.float32) + raw.reshape(3, 4)

    def estimates(self, names: Sequence[str]) -> dict[str, np.ndarray] | None:
        """`matrix` of every photograph by its name, names in the order of their numbers; None if nothing is learned."""
        return {name: self.matrix(view) for view, name in enumerate(names)} if self.learned else None

    def _applied(self, raw: Tensor, image: Tensor) -> Tensor:
        match self._kind:
            case "off":
                return image
            case "gain":
                return image * raw.exp()
        changed: Tensor = load("colours")(image, raw.view(3, 4))
        return changed


def write_colours(path: Path, colours: Mapping[str, np.ndarray]) -> None:
    """Write every photograph's colour transform, (3, 4), by name."""
    write_json(
        path,
        {
            "schema_name": SCHEMA,
            "version": VERSION,
            "convention": CONVENTION,
            "views": {name: matrix.astype(float).tolist() for name, matrix in colours.items()},
        },
    )


def read_colours(path: Path) -> dict[str, np.ndarray]:
    """Read a file that `write_colours` wrote: name -> (3, 4) float32. Raises InputError if it is damaged or of another
    version."""
    data = read_json(path)
    expected = f"colours of version {VERSION} beside a .ply: a 3 x 4 matrix a view"
    if not isinstance(data, dict) or (data.get("schema_name"), data.get("version")) != (SCHEMA, VERSION):
        raise InputError(path, "another schema or version", expected)
    try:
        found = {str(name): np.array(matrix, dtype=np.float32) for name, matrix in data["views"].items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(path, str(error), expected) from None
    for name, matrix in found.items():
        if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
            raise InputError(path, f"views.{name}: shape {matrix.shape} or a value that isn't finite", expected)
    return found
