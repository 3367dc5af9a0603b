"""Same seed, same numbers: the command line as a user calls it, on other numbers of threads."""

from __future__ import annotations

from pathlib import Path

import pytest
from called import called, dofbench, timeless

from dofbench.core.content import content_folder
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.result import read_result


def trained(folder: Path, threads: int) -> Path:
    """The result's folder of one run of 60 steps in a process of its own, with all that the default preset does."""
    options = {"method": "dofgaussian", "preset": "cpu", "budget": "60it", "data": folder / "data"}
    words = (word for name, value in options.items() for word in (f"--{name}", value))
    command = dofbench("run", *words, "--out", folder / f"on-{threads}")
    done = called(command, OMP_NUM_THREADS=str(threads), NUMBA_NUM_THREADS=str(threads))
    assert done.returncode == 0, done.stderr
    (file,) = (folder / f"on-{threads}").rglob("result.json")
    return file.parent


@pytest.mark.slow
def test_one_and_two_threads_give_the_same_bits(tmp_path: Path) -> None:
    make_dataset(
        MakeDataset(scene=str(content_folder("datasets") / "thinlens" / "foliage"), width=96, out=tmp_path / "data")
    )
    one, two = (trained(tmp_path, threads) for threads in (1, 2))
    files = [sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file()) for folder in (one, two)]
    assert files[0] == files[1] and Path("model/gaussians.ply") in files[0]
    different = [
        str(name)
        for name in files[0]
        if name.name != "result.json" and (one / name).read_bytes() != (two / name).read_bytes()
    ]
    assert different == []
    first, second = read_result(one), read_result(two)
    assert (first.machine["threads"], second.machine["threads"]) == (1, 2)
    assert timeless(first) == timeless(second)
    # It is a training that is compared: the scene grew, and came closer to the photographs.
    assert first.curve[-1].scores["aif_psnr"] > first.curve[0].scores["aif_psnr"] + 3
    assert first.curve[-1].loss < 0.7 * first.curve[0].loss
