"""Errors of the system and broken inputs: one line that names the file, and no finished file is lost."""

from __future__ import annotations

import os
import re
import resource
import shutil
from contextlib import contextmanager

import numpy as np
import pytest
from small_disk import small_disk

from dofbench.cli import app
from dofbench.core.images import read_exr, write_exr
from dofbench.datasets.synthesis import check_dataset
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_colmap


def command(capsys, *arguments):
    """Status and last line of standard error of a call of make-dataset."""
    status = app.main(["make-dataset", *map(str, arguments)])
    stderr = capsys.readouterr().err
    assert "Traceback" not in stderr
    return status, stderr.splitlines()[-1]


@contextmanager
def file_size_limit(limit):
    """Refuses writes in the middle of a file, as a full disk does, and needs no special rights."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    "limit, file",
    [
        (20, ".work/state.json"),
        (17_000, "all_in_focus/v02.png"),
        (40_000, "images_linear/v00.exr"),
        (50_000, "contact_sheet.png"),
    ],
)
def test_a_write_that_fails_in_the_middle(scene, dataset_folder, tmp_path, contents, capsys, limit, file):
    out = tmp_path / "out"
    with file_size_limit(limit):
        status, said = command(capsys, scene, "--out", out)
    assert (status, said) == (1, f"dofbench: {out / file}: File too large; finished work is kept")
    whole = contents(dataset_folder)
    finished = {name: content for name, content in contents(out).items() if not name.startswith(".work")}
    assert finished.items() <= whole.items()
    assert command(capsys, scene, "--out", out)[0] == 0
    assert contents(out) == whole


def test_a_model_that_fails_in_the_middle(scene, tmp_path):
    """Its library says nothing when a write fails."""
    loaded = load_scene(scene)
    with file_size_limit(1_000), pytest.raises(OSError, match="File too large"):
        write_colmap(
            tmp_path, [view.name for view in loaded.views], [view.camera for view in loaded.views], loaded.points
        )
    assert not list((tmp_path / "sparse" / "0").iterdir())


@pytest.mark.parametrize("room", range(100, 1000, 180))  # KiB; the dataset has about 1000
def test_a_full_disk(scene, dataset_folder, tmp_path, contents, capsys, room):
    disk = tmp_path / "disk"
    with small_disk(disk, room) as mounted:
        status, said = command(capsys, scene, "--out", disk / "out")
        assert status == 1
        assert re.fullmatch(rf"dofbench: {disk}/out\S*: No space left on device; finished work is kept", said)
        mounted("size=10m")
        assert command(capsys, scene, "--out", disk / "out")[0] == 0
        assert contents(disk / "out") == contents(dataset_folder)
        mounted("ro")
        status, said = command(capsys, scene, "--out", disk / "other")
        assert (status, said) == (1, f"dofbench: {disk / 'other'}: Read-only file system; finished work is kept")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder(scene, tmp_path, capsys):
    tmp_path.chmod(0o500)
    status, said = command(capsys, scene, "--out", tmp_path / "out")
    tmp_path.chmod(0o700)
    assert (status, said) == (1, f"dofbench: {tmp_path / 'out'}: Permission denied; finished work is kept")


def cut(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flip(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)


def depth_of(value):
    def damage(file):
        depth = read_exr(file)
        depth[10:20, 10:20] = value
        write_exr(file, depth)

    return damage


@pytest.mark.parametrize(
    "file, damage, found",
    [
        ("images/v04.png", cut, "no readable image"),
        ("images/v04.png", flip, "no readable image"),
        ("images/v04.png", lambda file: file.write_bytes(b""), "no readable image"),
        ("depth/v04.exr", cut, "no readable image"),
        ("depth/v04.exr", flip, "no readable image"),
        ("depth/v04.exr", depth_of(np.nan), "NaN in 100 of 12288 pixels"),
        ("depth/v04.exr", depth_of(-1), "negative values in 100 of 12288 pixels"),
        ("depth/v04.exr", lambda file: write_exr(file, np.zeros((96, 128), np.float32)), "no pixel of known depth"),
        ("sparse/0/points3D.bin", cut, "too few"),
        ("transforms.json", cut, "no JSON"),
    ],
)
def test_a_damaged_input_is_named_and_once_put_right_it_goes_on(
    write_scene, dataset_folder, tmp_path, contents, capsys, file, damage, found
):
    root, out = write_scene(tmp_path / "planes"), tmp_path / "out"
    shutil.copy(root / file, tmp_path / "kept")
    damage(root / file)
    status, said = command(capsys, root, "--out", out)
    assert status == 2
    assert re.match(rf"dofbench: {root / file}: found .*{found}.*, expected ", said)
    shutil.copy(tmp_path / "kept", root / file)
    assert command(capsys, root, "--out", out)[0] == 0
    assert contents(out) == contents(dataset_folder) and check_dataset(out) == []
