"""Setup for all tests: thread counts, hypothesis settings, and the location of real scenes."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

from dofbench.runtime.threads import available_cores, configure_threads

# `pytest -n` starts worker processes, which share the cores. With more threads than cores a test takes many times as
# long. A worker inherits the thread counts of the process that started it, so they are set whatever they were.
if (workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))) > 1:
    share = str(max(1, available_cores() // workers))
    os.environ.update(OMP_NUM_THREADS=share, NUMBA_NUM_THREADS=share)
configure_threads()  # before any test imports torch or numba
# Triton chooses when it is imported, and torch may import it, whether kernels are interpreted. On a GPU, run tests/gpu
# with TRITON_INTERPRET=0 to test them compiled.
os.environ.setdefault("TRITON_INTERPRET", "1")

import torch  # noqa: E402 - after the thread counts are set

# No deadline for an example, since the first call of a kernel compiles it. In CI the examples are the same every time,
# so that a failure is due to the change.
hypothesis.settings.register_profile("dofbench", deadline=None, max_examples=25, derandomize="CI" in os.environ)
hypothesis.settings.load_profile("dofbench")

MOST_WORKERS = 4  # each takes up to 2 GB of memory


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    """How many processes `pytest -n auto` starts: a container's CPU quota counts, which pytest-xdist doesn't know."""
    return min(available_cores(), MOST_WORKERS)


@pytest.hookimpl(trylast=True)  # once `-m` has dropped what isn't run
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no worker is left with one of them when the others have finished."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])  # stable: the tests of a file keep their order


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Checksums of the tests' files aren't kept in the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(autouse=True)
def _same_random_numbers() -> None:
    """A test that draws from torch's own generator gets the same numbers alone, in the suite, and in every run."""
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the checkout that holds these tests."""
    return REPOSITORY


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """`real_data("llff_fern")`: the folder of a real scene. Skips the test, saying why, where it is absent.

    The folder that holds the scenes is DOFBENCH_DATA, or else `../shared/data` beside the checkout.
    """
    root = Path(os.environ.get("DOFBENCH_DATA") or REPOSITORY.parent / "shared" / "data")

    def find(name: str) -> Path:
        folder = root / name
        if not folder.is_dir():
            pytest.skip(f"real data {name!r} is not in {root}; set DOFBENCH_DATA to the folder that holds it")
        return folder

    return find
