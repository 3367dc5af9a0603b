"""The notebooks run from start to end, by the interpreter that runs the tests."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import nbformat
import pytest
from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "notebooks"
# What a notebook shows, or writes, if it did what it is for.
SHOWN = {
    "1_look_at_a_dataset": r"Dataset\('tabletop', 17 training and 3 test views of 96 x 72 px",
    "2_blur_your_own_image": r"aperture 1\.\d\d of 1\.5, focus 0\.[67]\d of 0\.7",
    "3_train_refocus_film": r"LoadedRun\(dofgaussian short seed 0 on tabletop: ok",
    "4_read_a_board": r"'method': '3dgs', 'preset': '\S+', 'steps': '30', 'status': 'ok'",
    "5_put_your_trainer_on_the_board": r"'method': 'my_trainer', 'preset': '(stub|gsplat)', 'status': 'ok'",
}
PICTURES = {"1_look_at_a_dataset": 5, "2_blur_your_own_image": 3, "3_train_refocus_film": 4, "4_read_a_board": 1}


class OwnKernel(AsyncKernelManager):
    """The kernel of this interpreter: a kernel spec that is installed may belong to another."""

    @property
    def kernel_spec(self) -> KernelSpec:
        argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        return KernelSpec(argv=argv, display_name="own", language="python")


def outputs_of(notebook: str, folder: Path) -> tuple[str, int]:
    """Run it in `folder`: the text that it shows, and the number of its pictures."""
    nb = nbformat.read(FOLDER / f"{notebook}.ipynb", as_version=4)
    NotebookClient(
        nb, timeout=600, kernel_manager_class=OwnKernel, resources={"metadata": {"path": str(folder)}}
    ).execute()
    text, pictures = "", 0
    for output in (one for cell in nb.cells for one in cell.get("outputs", [])):
        data = output.get("data", {})
        text += output.get("text", "") + data.get("text/plain", "") + "\n"
        pictures += ("image/png" in data) + data.get("text/html", "").count("<img ")
    return text, pictures


def test_every_notebook_is_run() -> None:
    assert {file.stem for file in FOLDER.glob("*.ipynb")} == set(SHOWN)


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted(SHOWN))
def test_notebook(notebook: str, tmp_path: Path) -> None:
    text, pictures = outputs_of(notebook, tmp_path)
    assert re.search(SHOWN[notebook], text), text
    assert pictures >= PICTURES.get(notebook, 0)
    if notebook.startswith("3"):
        assert (tmp_path / "film" / "film.mp4").stat().st_size > 1000
    if notebook.startswith("5"):
        ran = "the stub" if "'preset': 'stub'" in text else "gsplat's example trainer"
        assert f"runs here: {ran}" in text


@pytest.mark.slow
def test_a_notebook_without_the_video_package_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module of that name that can't be found hides the package."""
    (tmp_path / "hide").mkdir()
    (tmp_path / "hide" / "sitecustomize.py").write_text(
        "import importlib.util\nfind = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name == 'av' else find(name, *rest)\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'hide'}:{FOLDER.parents[1]}")
    text, _ = outputs_of("3_train_refocus_film", tmp_path)
    assert "no film: the package av is missing" in text and not (tmp_path / "film").exists()
