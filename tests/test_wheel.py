"""The wheel holds all that dofbench needs, and works outside the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from dofbench.core.content import FOLDERS
from dofbench.evaluation.results.result import Result, read_result

LARGEST_WHEEL = 8_000_000  # bytes; the built-in scene takes 4.6 million, the built-in depth network 1.8 million

pytestmark = pytest.mark.slow  # builds a wheel, then compiles kernels anew: minutes


@pytest.fixture(scope="module")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy of the sources, so that the checkout gets no build folder."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    unwanted = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis")

    def ignored(place: str, names: list[str]) -> set[str]:
        outputs = {"data", "results"} if Path(place) == repository else set()
        return {*unwanted(place, names), *outputs}

    shutil.copytree(repository, source, ignore=ignored)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(source)]
    subprocess.run(command, check=True, cwd=folder)
    (built,) = folder.glob("dofbench-*.whl")
    return built


@pytest.fixture(scope="module")
def installation(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of a fresh environment with the wheel; dependencies are lent from the running one.

    A path file lends them: the running environment's own path files, an editable dofbench among
    them, are not followed from there.
    """
    folder = tmp_path_factory.mktemp("installed") / "venv"
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(install, check=True)
    (packages,) = (folder / "lib").glob("python*/site-packages")
    lent = dict.fromkeys([sysconfig.get_path("purelib"), sysconfig.get_path("platlib")])
    (packages / "lent.pth").write_text("\n".join(lent) + "\n")
    return folder / "bin"


def called(program: Path, *arguments: str, cwd: Path) -> str:
    """Standard output of a program run outside the checkout; a failure shows both streams."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "DOFBENCH"))}
    done = subprocess.run([program, *arguments], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{program.name} {' '.join(arguments)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_wheel_holds_every_source_and_nothing_else(wheel: Path, repository: Path) -> None:
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    expected = set()
    for folder in ("dofbench", *FOLDERS):
        prefix = "" if folder == "dofbench" else "dofbench/_content/"
        files = (path for path in (repository / folder).rglob("*") if path.is_file())
        names = (path.relative_to(repository).as_posix() for path in files if "__pycache__" not in path.parts)
        expected |= {prefix + name for name in names if not name.startswith("datasets/thinlens/")}
    assert inside == expected


def test_wheel_is_small(wheel: Path) -> None:
    assert wheel.stat().st_size < LARGEST_WHEEL


def test_content_is_found_in_the_installation(installation: Path, tmp_path: Path) -> None:
    script = (
        "import dofbench.runtime.ops, dofbench.methods\n"
        "from dofbench.core.content import FOLDERS, content_folder\n"
        "for name in FOLDERS: print(content_folder(name))\n"
        "for op in dofbench.runtime.ops.ops():\n"
        "    for backend in dofbench.runtime.ops.backends(op):\n"
        "        print(dofbench.runtime.ops.backend_of(op, backend))\n"
    )
    printed = called(installation / "python", "-c", script, cwd=tmp_path).splitlines()
    folders = [Path(line) for line in printed[: len(FOLDERS)]]
    assert all("_content" in folder.parts and folder.is_dir() for folder in folders)
    assert all(folder.is_relative_to(installation.parent) for folder in folders)
    assert len(printed) > len(FOLDERS)


def run(installation: Path, folder: Path, out: str) -> Result:
    """A handful of steps on the dataset `small`, by a method that needs most of the kernels."""
    words = ["run", "--method", "lensselect", "--data", "data/small", "--budget", "5it", "--out", out]
    called(installation / "dofbench", *words, cwd=folder)
    (file,) = (folder / out).rglob("result.json")
    return read_result(file.parent)


def test_the_whole_flow_works_outside_the_checkout(installation: Path, tmp_path: Path) -> None:
    """Scene to dataset to result to report, on the built-in scene. After warm-up no run compiles a kernel, and what is
    loaded trains to the same bits as what was compiled there and then."""
    dofbench = installation / "dofbench"
    assert called(dofbench, "--version", cwd=tmp_path).startswith("dofbench ")
    assert "tabletop" in called(dofbench, "scenes", cwd=tmp_path)
    called(dofbench, "make-dataset", "--width", "96", "--out", "data/small", cwd=tmp_path)
    called(dofbench, "check", "data/small", cwd=tmp_path)
    first = run(installation, tmp_path, "results")
    called(dofbench, "check", "results", cwd=tmp_path)
    called(dofbench, "report", "results", "--out", "reports", cwd=tmp_path)
    assert list((tmp_path / "reports").rglob("*.md"))
    assert str(installation.parent) in called(dofbench, "warm-up", cwd=tmp_path)
    again = run(installation, tmp_path, "again")
    assert first.kernels_compiled > 0 and again.kernels_compiled == 0
    assert first.model == again.model and len(first.model) > 0
