"""What a reconstruction removes of its output folder: what it made itself, and nothing of the user's."""

from __future__ import annotations

import pytest

from dofbench.core.errors import InputError
from dofbench.core.files import write_json
from dofbench.scenes.reconstruction.kept_steps import RECORD, Work


@pytest.fixture
def work(tmp_path):
    (tmp_path / "out").mkdir()
    return Work(tmp_path / "out")


def test_a_work_folder_of_another_program_stays(work):
    work.folder.mkdir()
    (work.folder / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="a folder that reconstruct didn't make"):
        work.begin("a")
    assert (work.folder / "thesis.tex").read_text() == "precious"


def test_a_finished_reconstruction_leaves_a_work_folder_of_the_users(work):
    write_json(work.root / RECORD, {"identity": "a"})
    work.folder.mkdir()
    (work.folder / "thesis.tex").write_text("precious")
    assert work.begin("a") == "complete"
    assert (work.folder / "thesis.tex").read_text() == "precious"


def test_images_that_the_user_put_there_meanwhile_are_no_leftover(work):
    assert work.begin("a") == "open"
    (work.root / "images").mkdir()
    (work.root / "images" / "mine.png").write_text("precious")
    with pytest.raises(InputError, match="files that are no reconstruction"):
        work.begin("a")
    assert (work.root / "images" / "mine.png").read_text() == "precious"


def test_cut_off_while_the_result_was_moved(work, monkeypatch):
    work.begin("a")
    for name in ("images/v0.png", "images/v1.png", "sparse/0/images.bin", RECORD):
        (work.scene / name).parent.mkdir(parents=True, exist_ok=True)
        (work.scene / name).write_text(name)
    write_json(work.scene / RECORD, {"identity": "a"})
    with monkeypatch.context() as patch:
        patch.setattr("shutil.rmtree", None)
        with pytest.raises(TypeError):
            work.finish()
    (work.root / RECORD).rename(work.root / "moved back")
    (work.root / "moved back").rename(work.scene / RECORD)
    (work.scene / "images").mkdir()
    (work.scene / "images" / "v1.png").write_text("images/v1.png")
    assert work.begin("a") == "open"
    work.finish()
    assert not work.folder.exists() and work.begin("a") == "complete"
    assert {path.read_text() for path in (work.root / "images").iterdir()} == {"images/v0.png", "images/v1.png"}
