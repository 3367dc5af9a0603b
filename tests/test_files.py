"""Atomic writing and checksums."""

import hashlib
import json
import os
import stat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dofbench.core.errors import InputError
from dofbench.core.files import (
    canonical_json,
    files_below,
    replacing,
    sha256_file,
    sha256_text,
    write_json,
    write_text,
)

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    file = tmp_path / "a.txt"
    write_text(file, "old")
    with pytest.raises(RuntimeError, match="halfway"), replacing(file) as temporary:
        temporary.write_text("new, but")
        assert temporary.suffix == ".txt" and temporary.parent == tmp_path
        raise RuntimeError("halfway")
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_folders_are_made_and_permissions_are_the_users(tmp_path):
    file = tmp_path / "deep" / "er" / "a.txt"
    write_text(file, "süß\n")
    assert file.read_bytes() == "süß\n".encode()
    plain = tmp_path / "plain"
    plain.touch()
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(file.stat().st_mode) == 0o666 & ~umask


@given(values)
def test_equal_values_give_equal_canonical_text(value):
    text = canonical_json(value)
    assert json.loads(text) == value
    assert canonical_json(json.loads(text)) == text
    text.encode("ascii")


def test_order_of_keys_doesnt_matter():
    assert canonical_json({"b": 1, "a": [2.5, None]}) == canonical_json({"a": [2.5, None], "b": 1})
    assert canonical_json({"b": 1, "a": 2}) == '{"a":2,"b":1}'


def test_json_keeps_what_is_not_finite(tmp_path):
    write_json(tmp_path / "a.json", {"x": float("inf"), "y": float("nan"), "z": 0.1})
    back = json.loads((tmp_path / "a.json").read_text())
    assert back["x"] == float("inf") and back["y"] != back["y"] and back["z"] == 0.1


@given(st.text())
def test_checksums_are_sha256(tmp_path_factory, text):
    file = tmp_path_factory.mktemp("sum") / "a.txt"
    file.write_bytes(text.encode())
    assert sha256_file(file) == sha256_text(text) == hashlib.sha256(text.encode()).hexdigest()


def test_files_behind_links_are_found_once(tmp_path):
    """A folder on another disk, two links to it, one to the folder above and one to nothing."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here / "b", here / "a", there / "deep"):
        folder.mkdir(parents=True)
        (folder / "x.json").write_text("{}")
        (folder / "y.txt").write_text("")
    (here / "c").symlink_to(there)
    (here / "d").symlink_to(there, target_is_directory=True)
    (there / "round").symlink_to(here)
    (here / "nowhere").symlink_to(tmp_path / "nothing")
    assert files_below(here, "x.json") == [here / "a/x.json", here / "b/x.json", here / "c/deep/x.json"]
    assert [file.name for file in files_below(here / "a", "*.*")] == ["x.json", "y.txt"]
    assert files_below(here / "d", "x*") == [
        here / f"d/{name}" for name in ("deep/x.json", "round/a/x.json", "round/b/x.json")
    ]
    assert files_below(tmp_path / "nothing", "*") == []


def test_a_folder_in_the_way_is_named(tmp_path):
    (tmp_path / "scores.csv").mkdir()
    with pytest.raises(InputError, match=r"scores\.csv: found a folder"):
        write_text(tmp_path / "scores.csv", "a")
    assert list(tmp_path.iterdir()) == [tmp_path / "scores.csv"], "no temporary file is left"
