"""make-dataset with several views at a time: the same bytes, and the same errors, as with one."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from dofbench.core.errors import InputError
from dofbench.core.files import temporaries
from dofbench.core.images import write_grey_png
from dofbench.core.progress import Advance, Progress, Silent
from dofbench.datasets.synthesis import builder, check_dataset, make_dataset, real_photographs, verify
from dofbench.datasets.synthesis.dataset_options import MakeDataset


@pytest.fixture
def several(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """`several(n)`: work on n views at a time."""

    def choose(count: int) -> None:
        for module in (builder, real_photographs, verify):
            monkeypatch.setattr(module, "views_at_once", lambda pixels: count)

    return choose


def make(scene: Path, out: Path, progress: Progress | None = None, **options) -> Path:
    return make_dataset(MakeDataset(scene=str(scene), out=out, **options), progress=progress or Silent())


@pytest.mark.parametrize(
    "options",
    [
        {"depth": "given", "normaliser": "view", "photons": 1000.0},
        {"depth": "splat", "depth_steps": 5},
        {"photographs": "shallow-train"},
    ],
    ids=["given", "splat", "photographs"],
)
def test_the_bytes_do_not_depend_on_how_many(scene, tmp_path, contents, several, options):
    masked = shutil.copytree(scene, tmp_path / "masked")
    for index in range(6):
        mask = np.ones((96, 128), np.float32)
        mask[:8, : 8 * index] = 0.0
        write_grey_png(masked / "masks" / f"v{index:02}.png", mask)
    several(1)
    expected = contents(make(masked, tmp_path / "one", **options))
    assert any(name.startswith("masks/") for name in expected)
    several(3)
    used = set()
    assert contents(make(masked, tmp_path / "three", Watching(lambda: used.update(_workers())), **options)) == expected
    assert used, "no thread was used"
    assert check_dataset(tmp_path / "three") == []


def _workers() -> Iterator[str]:
    return (thread.name for thread in threading.enumerate() if thread.name.startswith("view-"))


class Watching(Progress):
    """Calls a function whenever a unit of a stage is done."""

    def __init__(self, seen: Callable[[], object]):
        self._seen = seen

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        yield lambda done: self._seen()


def test_a_view_that_fails_is_named(scene, tmp_path, several):
    several(3)
    broken = shutil.copytree(scene, tmp_path / "broken")
    for name in ("v02", "v04"):
        file = broken / "images" / f"{name}.png"
        file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"v02\.png"):
        make(broken, tmp_path / "out")
    assert temporaries(tmp_path / "out") == []
    assert not list(_workers())


@pytest.mark.parametrize("stage", ["all-in-focus", "depth", "consistency", "blur"])
def test_interrupted_and_resumed(scene, dataset_folder, tmp_path, contents, several, stage):
    several(3)

    class Interrupting(Progress):
        @contextmanager
        def stage(self, name: str, total: int) -> Iterator[Advance]:
            def advance(done: int) -> None:
                if name == stage and done == 2:
                    raise KeyboardInterrupt

            yield advance

    with pytest.raises(KeyboardInterrupt):
        make(scene, tmp_path / "out", Interrupting())
    assert not list(_workers())
    assert not (tmp_path / "out" / "dataset.json").exists()
    make(scene, tmp_path / "out")
    assert contents(tmp_path / "out") == contents(dataset_folder)
