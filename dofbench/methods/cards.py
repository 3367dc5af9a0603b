"""Finding, describing and loading methods: a folder with a method.toml and modules."""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from dofbench.core.budget import Budget, parse_budget
from dofbench.core.clock import loading, planning
from dofbench.core.content import method_folders
from dofbench.core.contracts import Method
from dofbench.core.errors import InputError, unknown
from dofbench.core.readable import read_toml
from dofbench.methods.stages.stage_deciders import DECIDERS, LENS_DECIDERS
from dofbench.runtime.devices import KINDS, kind_of, resolve
from dofbench.runtime.ops import require

T = TypeVar("T")

_PARTS = ("fit", "render", "lens_estimates", "describe", "save", "load")


# What a card takes from that of the method that it is `like`.
LIKE = (
    "capabilities",
    "devices",
    "kernels",
    "presets",
    "default_preset",
    "builtin_preset",
    "gpu_preset",
    "stages",
    "trials",
    "costs",
)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Capabilities(_Strict):
    """What a method can do. refocus: renders with a given lens. learns_lens: estimates the lens of
    every training view. needs_points: can't start without sparse points. depth: renders depth. trains: false for
    pictures of the test views that others made: there are none of training views, and what they cost isn't known."""

    refocus: bool
    learns_lens: bool
    needs_points: bool
    depth: bool = True
    trains: bool = True


class Claims(_Strict):
    """Figures that the authors published, on their own data; never mixed with measured ones.

    source: where they stand. rows: what they were measured on -> metric id -> value.
    """

    source: str
    rows: dict[str, dict[str, float]]


class Costs(_Strict):
    """Seconds on two cores, for an estimate of the time before any run is finished: of a step, of a step for each pixel
    of a training view, and of each pixel of all training views before the first step (a depth prior)."""

    step: float = Field(ge=0)
    step_pixel: float = Field(ge=0)
    view_pixel: float = Field(0.0, ge=0)


class StageCard(_Strict):
    """A part of the method that a plan may skip.

    decided_by: the decider that says whether the data need it (one of `stage_deciders.DECIDERS`). option:
    the option by which it is switched; a user who sets it has decided. off: its value that leaves the stage out;
    without one the stage always runs, and the plan says what the data show. also: options that are set with it.
    tried_as: the word for it in the option that `Card.trials` names.
    """

    decided_by: str
    option: str | None = None
    off: Any = None
    also: dict[str, Any] = {}
    tried_as: str | None = None

    @property
    def switch(self) -> dict[str, Any] | None:
        """The options that skip the stage; None where it can't be skipped."""
        return None if self.option is None or self.off is None else {self.option: self.off, **self.also}


class Card(_Strict):
    """A method.toml.

    `class`: "module:ClassName", the module inside the method's folder. devices: the kinds of device that
    it runs on. kernels: the ops (`dofbench.runtime.ops.ops`) that it calls, which must run there too.
    presets: name -> options that replace the method's defaults, plus `budget` (as in `--budget`),
    which is the harness's; a preset without it trains for its option `steps`. A preset that `extends` another
    one replaces some of its options.
    builtin_preset: the preset of a run without a dataset, which shows the whole on the built-in one;
    without it, default_preset.
    gpu_preset: the preset of a run on a GPU; without it, default_preset. The built-in dataset's comes first.
    stages: name -> a part of the method that a plan may skip where the data don't need it.
    trials: the option that names, with commas between, what training tries out for itself.
    costs: what its default preset's training takes.
    elsewhere: it trains and renders in another program, so there is nothing to warm up, no curve and no speed.
    stands_in: option -> value -> the part of the method that this value replaces by something else, because the part
    isn't at hand here. Reports mark the rows of such runs.
    like: id of another method, whose card holds for all of `LIKE` that this card doesn't say. Stages are added to that
    card's, and so are presets, where an option of a preset of the same name replaces that card's.
    """

    name: str
    summary: str
    paper: str
    class_: str = Field(alias="class", pattern=r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$")
    default_preset: str
    builtin_preset: str | None = None
    gpu_preset: str | None = None
    capabilities: Capabilities
    devices: tuple[str, ...] = ("cpu",)
    kernels: tuple[str, ...] = ()
    presets: dict[str, dict[str, Any]]
    stages: dict[str, StageCard] = {}
    trials: str | None = None
    costs: Costs | None = None
    elsewhere: bool = False
    stands_in: dict[str, dict[str, str]] = {}
    like: str | None = None
    claims: Claims | None = None

    @field_validator("devices")
    @classmethod
    def _known_devices(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for device in value:
            if device not in KINDS:
                raise ValueError(f"unknown device {device!r}, expected one of {', '.join(KINDS)}")
        return value

    @model_validator(mode="after")
    def _stages_can_be_decided(self) -> Card:
        for name, stage in self.stages.items():
            if stage.decided_by not in DECIDERS:
                raise ValueError(f"stage {name}: unknown decider {stage.decided_by!r}, one of {', '.join(DECIDERS)}")
            if stage.decided_by in LENS_DECIDERS and not self.capabilities.learns_lens:
                raise ValueError(f"stage {name}: decided by {stage.decided_by}, of a method that learns no lens")
            if (stage.off is not None or stage.also) and stage.option is None:
                raise ValueError(f"stage {name}: no option that switches it")
            if stage.tried_as is not None and (self.trials is None or stage.option is None):
                raise ValueError(f"stage {name}: tried_as needs the stage's option and the card's trials")
        for decider, times in Counter(stage.decided_by for stage in self.stages.values()).items():
            if times > 1:
                raise ValueError(f"{times} stages decided by {decider}, expected one at most")
        return self

    def stages_in_order(self) -> list[tuple[str, StageCard]]:
        """Names and stages in the order of `DECIDERS`: some of these look at what others have decided."""
        order = list(DECIDERS)
        return sorted(self.stages.items(), key=lambda item: order.index(item[1].decided_by))

    def stage_decided_by(self, decider: str) -> str | None:
        """Name of the stage that asks this decider; None where none does."""
        return next((name for name, stage in self.stages.items() if stage.decided_by == decider), None)


@dataclass(frozen=True)
class MethodEntry:
    """A method that was found: its id (the folder's name), its folder and its card."""

    id: str
    folder: Path
    card: Card

    def preset(
        self, name: str | None, *, builtin: bool = False, device: str = "cpu"
    ) -> tuple[str, dict[str, Any], Budget | None]:
        """(name, options, budget) of a preset; None takes the default one on this device, or with `builtin` the one for
        the built-in dataset. Raises InputError.
        """
        if name is None:
            on_device = self.card.gpu_preset if kind_of(device) != "cpu" else None
            name = (self.card.builtin_preset if builtin else None) or on_device or self.card.default_preset
        if name not in self.card.presets:
            raise unknown(f"preset of {self.id}", name, self.card.presets)
        options = dict(self.card.presets[name])
        if (base := options.pop("extends", None)) is not None:
            options = {**self.card.presets[base], **options}
        text = options.pop("budget", None)
        return name, options, None if text is None else parse_budget(str(text))

    def replaced_parts(self, options: Mapping[str, Any]) -> list[str]:
        """The parts of the method that something else stands in for with these options (`Card.stands_in`)."""
        stands_in = self.card.stands_in.items()
        return [values[str(options[name])] for name, values in stands_in if str(options.get(name)) in values]

    def device_for(self, wanted: str) -> str:
        """The device of a run that asks for `wanted`, a device's name or "auto"; the method and every kernel that it
        calls can run there. Raises InputError that names what can't.
        """
        device = resolve(wanted, self.card.devices, self.id)
        for op in self.card.kernels:
            require(op, kind_of(device), f"method {self.id}")
        return device

    def create(self, options: dict[str, Any], seed: int, device: str) -> Method:
        """Import the method's class and call it as `Class(options, seed, device)`.

        The class raises InputError for an option that it doesn't know. Raises InputError as `method_class` does.
        """
        return self.method_class()(options, seed, device)

    def method_class(self) -> type:
        """Import the method's class.

        Raises InputError when the module has no such class or the class lacks a part of the contract.
        """
        module_name, class_name = self.card.class_.split(":")
        with planning.paused(), loading.running():
            module = importlib.import_module(f"{_package(self.id, self.folder)}.{module_name}")
        kind = getattr(module, class_name, None)
        if kind is None:
            raise InputError(
                self.folder / "method.toml",
                f"class = {self.card.class_!r}, which isn't there",
                f"a class of {module.__file__}",
            )
        missing = [part for part in _PARTS if not callable(getattr(kind, part, None))]
        if missing:
            raise InputError(
                f"{module.__file__}:{class_name}",
                f"no {', '.join(missing)}",
                f"the methods {', '.join(_PARTS)} (dofbench.core.contracts.Method)",
            )
        return kind


def preset_budget(entry: MethodEntry, preset: str, options: dict[str, Any], budget: Budget | None) -> Budget:
    """The budget of a preset where the call gives none: its own, else its option `steps`. options, budget: the
    preset's,
    the options perhaps changed by the call. Raises InputError where it has neither."""
    if budget is not None:
        return budget
    steps = options.get("steps")
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
        found = "neither budget nor steps" if steps is None else f"steps = {steps!r}"
        expected = "a budget, or steps above zero, or --budget on the command line"
        raise InputError(f"preset {preset} of {entry.id}", found, expected)
    return Budget(steps=steps)


_kept: ContextVar[dict[Any, Any] | None] = ContextVar("kept", default=None)


@contextmanager
def read_once() -> Iterator[None]:
    """Look for methods, and read each, once within the block: a report asks for them at every row."""
    token = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(token)


def kept(key: object, read: Callable[[], T]) -> T:
    """What `read` returns; within `read_once` what it returned first."""
    known = _kept.get()
    if known is None:
        return read()
    if key not in known:
        known[key] = read()
    found: T = known[key]
    return found


def method_files() -> dict[str, Path]:
    """The method.toml of every method in the searched folders, by id, sorted; none is read.

    Raises InputError for an id that is in two folders.
    """
    return kept("files", _method_files)


def _method_files() -> dict[str, Path]:
    found: dict[str, Path] = {}
    for root in method_folders():
        for file in sorted(root.glob("*/method.toml")):
            file = file.resolve()
            earlier = found.setdefault(file.parent.name, file)
            if earlier != file:
                raise InputError(
                    f"method {file.parent.name}", f"{earlier.parent} and {file.parent}", "one folder of that name"
                )
    return dict(sorted(found.items()))


def find_method(method_id: str) -> MethodEntry:
    """The method with this id; no other's method.toml is read. Raises InputError that lists what there is."""
    files = method_files()
    if method_id not in files:
        raise unknown("method", method_id, files)
    return kept(files[method_id], lambda: _entry(files[method_id]))


def _entry(file: Path) -> MethodEntry:
    return MethodEntry(id=file.parent.name, folder=file.parent, card=_read_card(file))


def _read_toml(file: Path) -> dict[str, Any]:
    return read_toml(file, "a TOML file")


def _completed(own: dict[str, Any], file: Path) -> dict[str, Any]:
    """The content of a method.toml with what it takes from that of the method that it is `like`."""
    if not isinstance(other := own.get("like"), str):
        return own
    files = method_files()
    known = [name for name, path in files.items() if path != file]
    if other not in known:
        raise InputError(file, f"like = {other!r}", f"another method: {', '.join(known)}")
    base = _read_toml(files[other])
    if "like" in base:
        raise InputError(
            file, f"like = {other!r}, which is itself like {base['like']!r}", "a method with all of a card"
        )
    found = {**{key: base[key] for key in LIKE if key in base}, **own}
    for table in ("stages", "presets"):
        theirs, ours = (card.get(table, {}) for card in (base, own))
        if isinstance(theirs, dict) and isinstance(ours, dict):  # of another type it is refused later
            found[table] = {**theirs, **ours}
            if table == "presets":
                for name in theirs.keys() & ours.keys():
                    found[table][name] = {**theirs[name], **ours[name]}
    return found


def _read_card(file: Path) -> Card:
    if not f"_{file.parent.name}".isidentifier():
        raise InputError(file.parent, "a folder name with other characters", "letters, digits and _")
    own = _completed(_read_toml(file), file)
    try:
        card = Card.model_validate(own)
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise InputError(file, found, "the keys that dofbench.methods.cards.Card describes") from None
    for key in ("default_preset", "builtin_preset", "gpu_preset"):
        if (value := getattr(card, key)) is not None and value not in card.presets:
            raise InputError(file, f"{key} = {value!r}", f"one of {', '.join(card.presets)}")
    bases = [name for name, options in card.presets.items() if "extends" not in options]
    for name, options in card.presets.items():
        if options.get("extends", bases[0] if bases else None) not in bases:
            raise InputError(
                file,
                f"presets.{name}: extends = {options.get('extends')!r}",
                f"one of {', '.join(bases)}, which extend nothing",
            )
    return card


def _package(method_id: str, folder: Path) -> str:
    """Make `dofbench.methods.<id>` the package in `folder`, so that its relative imports work."""
    name = f"dofbench.methods.{method_id}"
    parent = importlib.import_module("dofbench.methods")
    loaded = sys.modules.get(name)
    if loaded is not None and [Path(entry).resolve() for entry in loaded.__path__] == [folder]:
        return name
    # Another folder of the same id was loaded before (DOFBENCH_METHODS changed): forget all of it.
    for other in [module for module in sys.modules if module == name or module.startswith(name + ".")]:
        del sys.modules[other]
    importlib.invalidate_caches()
    initial = folder / "__init__.py"
    if initial.is_file():
        spec = importlib.util.spec_from_file_location(name, initial, submodule_search_locations=[str(folder)])
    else:
        spec = importlib.machinery.ModuleSpec(name, None, is_package=True)
        spec.submodule_search_locations = [str(folder)]
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    setattr(parent, method_id, module)
    if spec.loader is not None:
        spec.loader.exec_module(module)
    return name
