"""A result is outdated by a change of the code that it depends on, and by no other."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dofbench.core import source_digest
from dofbench.core.content import content_folder
from dofbench.evaluation.results import provenance


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package and the content next to it, to be edited."""
    root = tmp_path_factory.mktemp("tree")
    ignored = shutil.ignore_patterns("__pycache__", "_content")
    shutil.copytree(source_digest.PACKAGE, root / "dofbench", ignore=ignored)
    for name in ("kernels", "methods"):
        shutil.copytree(content_folder(name), root / name, ignore=ignored)
    return root


@pytest.fixture
def changed(copied: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that says whether one more line in a file changes the code version of a method on a device."""
    monkeypatch.setattr(source_digest, "PACKAGE", copied / "dofbench")
    monkeypatch.setattr(source_digest, "content_folder", lambda name: copied / name)
    monkeypatch.setattr(provenance, "method_folders", lambda: [copied / "methods"])

    def version(method: str, device: str) -> str:
        source_digest.package_digest.cache_clear()
        return provenance.code_version(copied / "methods" / method, device)

    def outdates(name: str, method: str, device: str) -> bool:
        file, before = copied / name, version(method, device)
        text = file.read_text()
        file.write_text(text + "\nCHANGED = 1\n")
        after = version(method, device)
        file.write_text(text)
        return before != after

    yield outdates
    source_digest.package_digest.cache_clear()


@pytest.mark.parametrize(
    ("name", "method", "device", "expected"),
    [
        ("dofbench/core/lens.py", "bags", "cpu", True),
        ("dofbench/core/similarity.py", "bags", "cpu", True),
        ("kernels/scatter/cpu.py", "bags", "cpu", True),
        ("methods/bags/method.py", "bags", "cpu", True),
        ("methods/mipsplatting/method.py", "bags", "cpu", True),  # bags is like it
        ("methods/dofgaussian/method.py", "bags", "cpu", False),
        ("dofbench/reporting/render.py", "bags", "cpu", False),
        ("methods/deblurnerf/method.py", "pdrf", "cpu", True),  # pdrf imports from it
        ("methods/pdrf/method.py", "deblurnerf", "cpu", False),
        ("kernels/tone/gpu.py", "bags", "cpu", False),
        ("kernels/tone/gpu.py", "bags", "cuda", True),
    ],
)
def test_a_change_of_code_outdates_what_depends_on_it(
    changed, name: str, method: str, device: str, expected: bool
) -> None:
    assert changed(name, method, device) == expected


def test_a_renamed_file_and_a_moved_line_are_changes(tmp_path: Path) -> None:
    def digest(**files: str) -> str:
        folder = tmp_path / "-".join(files)
        folder.mkdir(exist_ok=True)
        for name, text in files.items():
            (folder / f"{name}.py").write_text(text)
        return source_digest.source_digest([folder])

    found = digest(a="x = 1\n", b=""), digest(c="x = 1\n", b=""), digest(a="", b="x = 1\n")
    assert len(set(found)) == 3 and digest(a="x = 1\n", b="") == found[0]


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nothing"):
        source_digest.source_digest([tmp_path / "nothing"])
