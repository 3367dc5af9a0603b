"""A finished run, read back from its folder: its result, the dataset that it was made on, and the trained method.

Nothing heavy is imported here before it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from os.path import normpath
from pathlib import Path
from typing import TYPE_CHECKING

from dofbench.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from dofbench.core.contracts import Method
    from dofbench.datasets.format.dataset import Dataset
    from dofbench.evaluation.results.result import Result
    from dofbench.running.model import Model

_ABOVE = 5  # folders above a result in which its dataset is looked for


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """folder: the result's. result: what result.json says. data: where the dataset is looked for.

    `dataset` and `method` are read when they are asked for first: a result can be read where neither is there any more.
    """

    folder: Path
    result: Result
    data: Path

    def __repr__(self) -> str:
        return f"LoadedRun({self.result.line()}, in {self.folder})"

    def _repr_html_(self) -> str:
        from dofbench.core.notebook import as_html

        return as_html(repr(self), self._pictures(), self.result.shown_scores())

    @cached_property
    def dataset(self) -> Dataset:
        """The dataset that the run was made on. Raises InputError when it isn't in `data`, or another one is."""
        from dofbench.core.files import sha256_file
        from dofbench.datasets.format.dataset import Dataset
        from dofbench.datasets.format.schema import MANIFEST

        spec = self.result.spec
        if not (self.data / MANIFEST).is_file():
            expected = f"the dataset {spec.dataset} of this run; --data, or load_run's data, names another place"
            raise InputError(self.data, "no dataset there or near the result", expected)
        # Before it is read: a report asks for the dataset of every run.
        if (checksum := sha256_file(self.data / MANIFEST)) != spec.dataset_checksum:
            raise InputError(
                self.data,
                f"a dataset of checksum {checksum[:16]}",
                f"{spec.dataset} of checksum {spec.dataset_checksum[:16]}, that it was run on",
            )
        return Dataset.load(self.data)

    @cached_property
    def method(self) -> Method:
        """The trained method, as it was kept: it renders, and has its lens estimates.

        Raises InputError when the run kept no model, when a file of it isn't the one that was kept, or when its method
        isn't installed. What the method's own code raises at a model that it can't read, it raises.
        """
        from dofbench.evaluation.results.result import MODEL_FOLDER
        from dofbench.methods.cards import find_method

        if reason := self.no_model():
            raise InputError(self.folder, reason, "the model as `dofbench run` kept it")
        spec = self.result.spec
        method = find_method(spec.method).create(dict(spec.options), spec.seed, spec.device)
        method.load(self.folder / MODEL_FOLDER)
        return method

    @cached_property
    def model(self) -> Model:
        """The trained scene, to render at any camera, through any lens. Raises InputError as `method`."""
        from dofbench.running.model import Model

        return Model(self.method, lambda: self.dataset.disparity_range)

    def no_model(self) -> str:
        """Why the model isn't there as it was kept, one line; "" where it is."""
        from dofbench.evaluation.results.result import MODEL_FOLDER

        if not (self.folder / MODEL_FOLDER).is_dir():
            return "the run kept no model"
        for name, checksum in self.result.model.items():
            if not self._is(name, checksum):
                return f"{name} isn't the file that the run kept"
        return ""

    def prediction(self, kind: str, view: str) -> Path:
        """The kept picture of a test view. kind: as in `dofbench.evaluation.scoring.evaluate.Kind`.

        Raises InputError when the result has none, or the file isn't the one that was scored.
        """
        name = f"predictions/{kind}/{view}.png"
        checksum, file = self.result.predictions.get(name), self.folder / name
        if checksum is None:
            raise InputError(self.folder, f"no {name} in its result", "a picture that the run kept")
        if not self._is(name, checksum):
            raise InputError(file, "another picture" if file.is_file() else "no file", "the one that was scored")
        return file

    def _pictures(self) -> list[tuple[str, np.ndarray]]:
        """The first test view's image and what was rendered of it, where they are kept."""
        from dofbench.core.images import read_image
        from dofbench.datasets.format import layout

        views = sorted(view.name for view in self.result.views)
        if not views:
            return []
        image, found = layout.shallow_path(self.data, views[0]), []
        if image.is_file():
            found.append((f"{views[0]}: image", read_image(image)))
        for name in sorted(self.result.predictions):
            kind, view = name.removeprefix("predictions/").partition("/")[::2]
            if view == f"{views[0]}.png" and (self.folder / name).is_file():
                found.append((f"{kind.replace('_', ' ')}, rendered", read_image(self.folder / name)))
        return found

    def _is(self, name: str, checksum: str) -> bool:
        from dofbench.core.files import sha256_file

        return (self.folder / name).is_file() and sha256_file(self.folder / name) == checksum


def load_run(folder: Path | str, data: Path | str | None = None) -> LoadedRun:
    """Open the result in `folder` (or the result.json itself), with its dataset and its trained method.

    data: where the dataset is now; None to look for it (`find_data`). The paths of the run are absolute, so it can be
    used after the current folder has changed. Raises InputError when there is no readable result.
    """
    from dofbench.core.files import files_below
    from dofbench.evaluation.results.result import RESULT_FILE, read_result

    folder = Path(folder)
    folder = folder.parent if folder.is_file() else folder
    below = [] if (folder / RESULT_FILE).exists() else sorted(files_below(folder, RESULT_FILE))
    if below:
        raise InputError(folder, f"{len(below)} results below", f"the folder of one, such as {below[0].parent}")
    run = loaded(folder.absolute(), read_result(folder), None if data is None else Path(data))
    # A dataset that isn't there is named as the result says it.
    return replace(run, data=run.data.absolute()) if run.data.exists() else run


def loaded(folder: Path, result: Result, data: Path | None = None) -> LoadedRun:
    """The run of a result that was read already. data: as in `load_run`."""
    return LoadedRun(folder, result, find_data(folder, result) if data is None else data)


def find_data(folder: Path, result: Result) -> Path:
    """Where the dataset of the result in `folder` is: where the result says, as seen from the current folder, or from
    its own; else by its name or path beside one of the folders above. Only the very dataset counts, by its checksum.

    Where there is none, the path that the result says.
    """
    from dofbench.core.files import sha256_file
    from dofbench.datasets.format.schema import MANIFEST

    said, here = Path(result.data), folder.resolve()
    above = [here, *here.parents][: _ABOVE + 1]
    places = [said, *([Path(normpath(here / result.data_from_here))] if result.data_from_here else [])]
    if not said.is_absolute():
        places += [place / said for place in above]
    places += [place / name for place in above for name in (result.spec.dataset, Path("data") / result.spec.dataset)]
    for place in places:
        try:
            if (place / MANIFEST).is_file() and sha256_file(place / MANIFEST) == result.spec.dataset_checksum:
                return place
        except (OSError, ValueError):  # not readable, or a path that can't be one
            continue
    return said
