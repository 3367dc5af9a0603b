"""The scene as it is while it trains, for `dofbench view` (`dofbench run --watch`)."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

from dofbench.core.contracts import Method
from dofbench.core.errors import InputError
from dofbench.core.files import read_json, write_json
from dofbench.evaluation.results.result import Spec
from dofbench.methods.cards import find_method

SNAPSHOT_FOLDER = "snapshots"  # in the run's folder, while it trains
EVERY = 10.0  # s between two snapshots
_ABOUT = "snapshot.json"


class Snapshots:
    """Saves a method in training every few seconds. It draws no random numbers, so the training stays the same."""

    def __init__(self, folder: Path, method: Method, spec: Spec, data: Path):
        self._folder, self._method = folder / SNAPSHOT_FOLDER, method
        self._about = {"spec": spec.model_dump(mode="json"), "data": str(data.resolve())}
        self._last = time.monotonic() - EVERY

    def due(self) -> bool:
        """Whether it is time for another one."""
        return time.monotonic() - self._last >= EVERY

    def save(self, step: int) -> None:
        """Save the method after this step, and remove older snapshots but the last, which may be being read."""
        part = self._folder / f".{step:08d}.part"
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        self._method.save(part)
        write_json(part / _ABOUT, {**self._about, "step": step})
        part.rename(self._folder / f"{step:08d}")
        for old in found(self._folder.parent)[:-2]:
            shutil.rmtree(old, ignore_errors=True)
        self._last = time.monotonic()


def found(run: Path) -> list[Path]:
    """The snapshots in a run's folder, oldest first."""
    return sorted(path for path in (run / SNAPSHOT_FOLDER).glob("[0-9]*") if path.is_dir())


def read_snapshot(folder: Path) -> tuple[Method, Spec, Path, int]:
    """(method, spec, dataset's folder, step) of a snapshot. Raises InputError for a damaged one."""
    about: Any = read_json(folder / _ABOUT)
    try:
        spec, data, step = Spec.model_validate(about["spec"]), Path(about["data"]), int(about["step"])
    except (KeyError, TypeError, ValueError):
        raise InputError(folder / _ABOUT, "no record of a snapshot", "what `dofbench run --watch` writes") from None
    method = find_method(spec.method).create(dict(spec.options), spec.seed, spec.device)
    method.load(folder)
    return method, spec, data, step
