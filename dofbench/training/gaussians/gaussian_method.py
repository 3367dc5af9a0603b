"""The `Method` contract implemented on the trainer; a Gaussian method adds only its options."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dofbench.core.budget import Budget
from dofbench.core.cameras import NO_OFFSET, Camera
from dofbench.core.contracts import FitOutcome, Observer, Rendering, TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens
from dofbench.runtime.device_memory import forget_peak, peak_mb
from dofbench.runtime.devices import KINDS, resolve
from dofbench.training.common.lens_file import read_lenses, write_lenses
from dofbench.training.common.options import ListedOption, listed_options
from dofbench.training.common.photograph_colours import FILE as COLOURS
from dofbench.training.common.photograph_colours import read_colours, write_colours
from dofbench.training.common.priors import Prior
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_renderer import LensRenderer
from dofbench.training.gaussians.model import NEAR, Gaussians
from dofbench.training.gaussians.splats import lower_degree, read_offset, read_splats, write_splats
from dofbench.training.gaussians.trainer import Trainer, TrainerState

_MODEL, _LENSES = "gaussians.ply", "lenses.json"
# Options with which a trained scene is rendered, in the order of lenses.json.
RENDERING = (
    "sh_degree",
    "background",
    "filter_2d",
    "lens",
    "lens_model",
    "lens_rings",
    "lens_blades",
    "lens_rotation",
    "lens_gamma",
    "lens_alpha",
    "lens_energy",
)
NEAR_PLANE = "near"  # recorded with them; not an option
_CONVENTIONS = {
    "blur": "of colours raised to lens_gamma; lens_model scatter: each pixel of the sharp image is spread evenly over "
    "its disc, or polygon of lens_blades sides, with a rim of softness 1 / lens_alpha, its weight divided by "
    "the area unless lens_energy is algorithm1; lens_model samples: the scene as seen from aperture samples",
    "filter_2d": "pixels^2, added to every footprint's covariance, opacity times sqrt(det before / det after)",
    "near": "scene units: a Gaussian whose centre isn't farther than this in z isn't drawn",
    "background": "grey level behind the scene, encoded like the colours",
}


class GaussianMethod:
    """Base of the Gaussian methods. OPTIONS: the class of the method's options. FORCED: options that define the method
    and can't be set."""

    OPTIONS: ClassVar[type[GaussianOptions]] = GaussianOptions
    FORCED: ClassVar[Mapping[str, Any]] = {}

    def __init__(self, options: Mapping[str, Any], seed: int, device: str):
        self._device = resolve(device, KINDS, "training of Gaussians")
        self._options = self.read_options(options)
        self._seed = seed
        self._gaussians: Gaussians | None = None
        self._trainer: Trainer | None = None
        self._kept: tuple[TrainerState, Prior | None] | None = None  # of a training in an earlier process
        self._renderer: LensRenderer | None = None  # of a model that isn't being trained
        self._lenses: dict[str, PhysicalLens] | None = None
        self._colours: dict[str, np.ndarray] | None = None
        self._peak: dict[str, float] = {}
        self._offset = NO_OFFSET

    @classmethod
    def read_options(cls, options: Mapping[str, Any]) -> GaussianOptions:
        """All options with their defaults. Raises InputError for an unknown or fixed one, or a wrong value."""
        fixed = sorted(set(options) & set(cls.FORCED))
        if fixed:
            raise InputError(f"option {fixed[0]}", "a value", "none: this method fixes it")
        return cls.OPTIONS.of(**options, **cls.FORCED)

    @classmethod
    def available_options(cls) -> tuple[ListedOption, ...]:
        """Every option that a user of this method may set, with type, default, meaning, unit and source."""
        return tuple(option for option in listed_options(cls.OPTIONS) if option.name not in cls.FORCED)

    @property
    def options(self) -> GaussianOptions:
        """The current options, which trials may have revised."""
        return self._trainer.options if self._trainer else self._options

    def fit(self, training_set: TrainingSet, budget: Budget, observer: Observer) -> FitOutcome:
        """Train from the sparse points; raises InputError when there are none."""
        forget_peak(self._device)
        self._trainer = Trainer(training_set, self._options, self._seed, self._device)
        if self._kept is not None:
            self._trainer.resume_from(*self._kept)
            self._kept = None
        self._gaussians, self._renderer = self._trainer.gaussians, None
        self._offset = training_set.offset
        outcome = self._trainer.fit(budget, observer)
        self._peak = peak_mb(self._device)
        self._renderer = LensRenderer(self._gaussians, self.options)
        return outcome

    def training_state(self) -> object:
        """See `dofbench.core.contracts.Resumes`."""
        return self.trainer.training_state()

    def constant_state(self) -> object:
        """See `dofbench.core.contracts.Resumes`: the depth prior."""
        return self.trainer.prior

    def resume_from(self, state: Any, constant: Any) -> None:
        """See `dofbench.core.contracts.Resumes`."""
        self._kept = state, constant

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render; ValueError for a lens when the method has none."""
        if lens is not None and not self.options.lens.lens:
            raise ValueError("this method has no lens: it can't refocus")
        return self.renderer.render(camera, lens)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of every training view, None without a lens."""
        return self._trainer.lens_estimates() if self._trainer else self._lenses

    def colour_estimates(self) -> dict[str, np.ndarray] | None:
        """The learned colour correction of every training view, (3, 4) as in `photograph_colours.py`, or None."""
        return self._trainer.colour_estimates() if self._trainer else self._colours

    def predict_photograph(self, name: str, pixels: np.ndarray) -> np.ndarray:
        """The whole training view, (H, W, 3), encoded. Raises RuntimeError for a model that was loaded."""
        return self.trainer.render_view([view.name for view in self.trainer.views].index(name))

    def describe(self) -> dict[str, float]:
        """Number of Gaussians; after training on a GPU its peak memory too, MB."""
        return {"gaussians": len(self.gaussians), **self._peak}

    def save(self, folder: Path) -> None:
        """Write the Gaussians as 3DGS' .ply, the lenses and rendering options as JSON, and learned colours.

        The .ply has the coordinates of the scene's files; its header states the offset, which `load` subtracts. The 3D
        filter is merged into the Gaussians, so a model that is read back renders the same except for rounding.
        """
        shown = self.gaussians
        if not self.options.appearance.filter_3d:
            shown = Gaussians(shown.parameters, None, shown.near)
        write_splats(folder / _MODEL, shown, self._offset)
        values = self.options.flat()
        rendering = {**{name: values[name] for name in RENDERING}, NEAR_PLANE: self.gaussians.near}
        write_lenses(folder / _LENSES, self.lens_estimates(), rendering, _CONVENTIONS)
        if (colours := self.colour_estimates()) is not None:
            write_colours(folder / COLOURS, colours)

    def load(self, folder: Path) -> None:
        """Read a model that `save` wrote; raises InputError when a file is missing or damaged."""
        self._offset = read_offset(folder / _MODEL)
        gaussians = read_splats(folder / _MODEL, self._offset)
        self._lenses, rendering = read_lenses(folder / _LENSES, (*RENDERING, NEAR_PLANE))
        near = rendering.pop(NEAR_PLANE, NEAR)
        if isinstance(near, str) or not near > 0:
            raise InputError(folder / _LENSES, f"rendering.{NEAR_PLANE}: {near}", "a distance above 0")
        gaussians = gaussians.on(self._device)
        gaussians.near = float(near)
        self._options = self._options.with_overrides(rendering, f"{folder / _LENSES}: rendering")
        self._gaussians = lower_degree(gaussians, self._options.appearance.sh_degree)
        self._colours = read_colours(folder / COLOURS) if (folder / COLOURS).is_file() else None
        self._trainer, self._renderer = None, LensRenderer(self._gaussians, self._options)

    @property
    def trainer(self) -> Trainer:
        """The trainer, during `fit` and after it. Raises RuntimeError for a model that was loaded."""
        if self._trainer is None:
            raise RuntimeError("the method isn't trained here: call fit first")
        return self._trainer

    @property
    def renderer(self) -> LensRenderer:
        """The renderer of the model, which also gives tensors on its device."""
        return self._renderer or LensRenderer(self.gaussians, self.options)

    @property
    def gaussians(self) -> Gaussians:
        """The trained Gaussians. Raises RuntimeError before there are any."""
        if self._gaussians is None:
            raise RuntimeError("the method holds no model: call fit or load first")
        return self._gaussians


class LenslessMethod(GaussianMethod):
    """Base of the Gaussian methods without a lens, and so without adaptation to it."""

    FORCED: ClassVar[Mapping[str, Any]] = {"lens": False, "adaptation": "off"}
