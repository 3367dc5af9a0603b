"""The `Method` contract implemented on the trainer of radiance fields; a method adds its forward model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import FitOutcome, Observer, Rendering, TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.files import replacing
from dofbench.core.lens import PhysicalLens
from dofbench.core.readable import parse_json, read_arrays
from dofbench.runtime.device_memory import forget_peak, peak_mb
from dofbench.runtime.devices import KINDS, resolve
from dofbench.training.common.options import ListedOption, listed_options
from dofbench.training.common.photograph_colours import FILE as COLOURS
from dofbench.training.common.photograph_colours import read_colours, write_colours
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.field_scene import FieldScene, Surroundings
from dofbench.training.fields.field_trainer import FieldTrainer
from dofbench.training.fields.grid_field import PARAMETERS, GridField
from dofbench.training.fields.ray_model import RayModel
from dofbench.training.fields.space import space_of

_MODEL = "field.npz"
_EXPECTED = "a field that `dofbench run` stored"


class FieldMethod:
    """Base of the radiance fields; by itself it assumes all-in-focus inputs. OPTIONS: the class of its options."""

    OPTIONS: ClassVar[type[FieldOptions]] = FieldOptions

    def __init__(self, options: Mapping[str, Any], seed: int, device: str):
        self._device = resolve(device, KINDS, "training of fields")
        self._options, self._seed = self.read_options(options), seed
        self._scene: FieldScene | None = None
        self._trainer: FieldTrainer | None = None
        self._random = torch.Generator()
        self._kept: dict[str, Any] | None = None  # state of a training in an earlier process
        self._names: list[str] = []
        self._colours: dict[str, np.ndarray] | None = None
        self._peak: dict[str, float] = {}

    @classmethod
    def read_options(cls, options: Mapping[str, Any]) -> FieldOptions:
        """All options with their defaults. Raises InputError for an unknown one or a wrong value."""
        return cls.OPTIONS.of(**options)

    @classmethod
    def available_options(cls) -> tuple[ListedOption, ...]:
        """Every option that a user of this method may set, with type, default, meaning, unit and source."""
        return listed_options(cls.OPTIONS)

    @property
    def options(self) -> FieldOptions:
        """The options that the method trains with."""
        return self._options

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """Make the forward model of the training views. generator: for all that it draws."""
        return RayModel()

    def fit(self, training_set: TrainingSet, budget: Budget, observer: Observer) -> FitOutcome:
        """Train from an empty field; raises InputError without sparse points, which give the scene's place."""
        forget_peak(self._device)
        self._random = torch.Generator().manual_seed(self._seed)
        model = self.model(training_set, self._random)
        trainer = FieldTrainer(training_set, self._options, model, self._seed, self._device)
        if self._kept is not None:
            self._take_over(self._kept, trainer)
            self._kept = None
        self._scene, self._trainer = trainer.scene, trainer
        self._names = [view.name for view in training_set.views]
        outcome = trainer.fit(budget, observer)
        self._colours = trainer.colour_estimates()
        self._peak = peak_mb(self._device)
        return outcome

    def training_state(self) -> dict[str, Any]:
        """See `dofbench.core.contracts.Resumes`."""
        assert self._trainer is not None
        return {"random": self._random, "trainer": self._trainer.training_state()}

    def _take_over(self, kept: dict[str, Any], trainer: FieldTrainer) -> None:
        """Take over what `training_state` gave, in which the forward model and the method share objects."""
        self._random = kept["random"]
        trainer.resume_from(kept["trainer"])

    def constant_state(self) -> object:
        """See `dofbench.core.contracts.Resumes`: nothing."""
        return None

    def resume_from(self, state: Any, constant: Any) -> None:
        """See `dofbench.core.contracts.Resumes`."""
        self._kept = state

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render all in focus; ValueError for a lens."""
        if lens is not None:
            raise ValueError("this method has no lens: it can't refocus")
        return self._trained().render(camera)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """None: no lens is learned."""
        return None

    def colour_estimates(self) -> dict[str, np.ndarray] | None:
        """The learned colour correction of every training view, (3, 4) as in `photograph_colours.py`, or None."""
        return self._colours

    def predict_photograph(self, name: str, pixels: np.ndarray) -> np.ndarray:
        """The training view, (H, W, 3), encoded, where `pixels` is true; the same in every call, and without an effect
        on a training. Raises RuntimeError for a model that was loaded."""
        if self._trainer is None:
            raise RuntimeError("the method isn't trained here: call fit first")
        state = self._random.get_state()
        self._random.manual_seed(self._seed)
        try:
            return self._trainer.predict_view(self._names.index(name), pixels)
        finally:
            self._random.set_state(state)

    def describe(self) -> dict[str, float]:
        """After training on a GPU its peak memory, MB."""
        return dict(self._peak)

    def save(self, folder: Path) -> None:
        """Write field, space and options as one NumPy archive, and learned colours."""
        scene = self._trained()
        field = scene.field
        arrays: dict[str, Any] = {name: tensor.numpy(force=True) for name, tensor in scene.parameters.items()}
        arrays |= {f"space_{name}": array for name, array in scene.space.record().items()}
        occupied = np.packbits(scene.occupancy.occupied.numpy(force=True))
        arrays |= {"nodes": np.array(field.shape.nodes), "occupied": occupied}
        arrays["options"] = np.array(json.dumps(self._options.flat()))
        with replacing(folder / _MODEL) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)
        if self._colours is not None:
            write_colours(folder / COLOURS, self._colours)

    def load(self, folder: Path) -> None:
        """Read a model that `save` wrote; raises InputError when the file is missing or damaged."""
        path = folder / _MODEL
        try:
            arrays = read_arrays(path, _EXPECTED)
            options = self.OPTIONS.of(**parse_json(str(arrays["options"]), path))
            shape = options.grid.shape([int(count) for count in arrays["nodes"]])
            parameters = {name: torch.from_numpy(arrays[name]).to(self._device) for name in PARAMETERS}
            record = {name.removeprefix("space_"): arrays[name] for name in arrays if name.startswith("space_")}
            space, cells = space_of(record), options.rays.cells
            behind = None
            if space.has_surroundings:
                behind = Surroundings(torch.from_numpy(arrays["surroundings"]).to(self._device))
            occupied = np.unpackbits(arrays["occupied"], count=cells**3).reshape(cells, cells, cells)
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, IndexError, OverflowError, RuntimeError) as error:
            raise InputError(path, str(error), _EXPECTED) from None
        sizes = (len(parameters["density"]), len(parameters["colour"]), tuple(parameters["basis"].shape))
        if sizes != (shape.density_size, shape.colour_size, shape.basis_shape):
            raise InputError(path, f"tensors of {sizes}", f"those of a grid of {shape.nodes} nodes")
        self._options = options
        self._trainer = None
        field = GridField(shape, parameters, options.grid.density_shift)
        self._scene = FieldScene(field, space, options, behind)
        self._colours = read_colours(folder / COLOURS) if (folder / COLOURS).is_file() else None
        self._scene.occupancy.occupied = torch.from_numpy(occupied.astype(bool)).to(self._device)

    def _trained(self) -> FieldScene:
        if self._scene is None:
            raise RuntimeError("the method holds no model: call fit or load first")
        return self._scene
