"""Axes and rigidity of poses."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE, ROUNDED_ROTATION

from dofbench.core.errors import InputError
from dofbench.scenes.readers.poses import Mended, invert, llff_to_opencv, opencv_to_llff, opengl_to_opencv, rigid


def random_pose(seed):
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation[:, 0] *= np.sign(np.linalg.det(rotation))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rng.normal(size=3)
    return pose


@given(st.integers(0, 10_000))
def test_llff_and_opengl_axes_go_there_and_back(seed):
    pose = random_pose(seed)
    assert np.array_equal(llff_to_opencv(opencv_to_llff(pose)), pose[:3])
    assert np.array_equal(opengl_to_opencv(opengl_to_opencv(pose)), pose)


def test_axes_mean_what_they_say():
    # A camera at the origin that looks along world z, with x to the right and y down.
    llff = opencv_to_llff(np.eye(4))
    assert llff[:, 0].tolist() == [0, 1, 0], "first column of LLFF points down"
    assert llff[:, 1].tolist() == [1, 0, 0], "second points right"
    assert llff[:, 2].tolist() == [0, 0, -1], "third points backwards"
    opengl = opengl_to_opencv(np.eye(4))
    assert opengl[:3, 1].tolist() == [0, -1, 0], "second column of OpenGL points up"
    assert opengl[:3, 2].tolist() == [0, 0, -1], "third points backwards"


@given(st.integers(0, 10_000))
def test_inverse_and_exactness(seed):
    pose = random_pose(seed)
    np.testing.assert_allclose(invert(pose) @ pose, np.eye(4), atol=FLOAT64_VALUE)
    np.testing.assert_allclose(rigid(pose, "file", "view"), pose, rtol=0, atol=0)
    rounded = np.round(pose, 6)
    repaired = rigid(rounded, "file", "view")[:3, :3]
    np.testing.assert_allclose(repaired.T @ repaired, np.eye(3), atol=FLOAT64_VALUE)


@given(st.integers(0, 10_000), st.sampled_from([3, 4]), st.sampled_from([1.0, 0.35, 40.0]))
def test_rounded_and_scaled_rotations_are_mended_and_said(seed, digits, scale):
    pose = random_pose(seed)
    written = pose.copy()
    written[:3, :3] = scale * np.round(pose[:3, :3], digits)
    mended = Mended()
    found = rigid(written, "file", "view", mended)
    np.testing.assert_allclose(found[:3, :3].T @ found[:3, :3], np.eye(3), atol=FLOAT64_VALUE)
    np.testing.assert_allclose(found[:3, :3], pose[:3, :3], atol=ROUNDED_ROTATION)
    np.testing.assert_array_equal(found[:3, 3], pose[:3, 3])
    assert len(mended.scales) == (scale != 1)
    assert len(mended.notes(Path("file"))) == len(mended.scales) + len(mended.off)


@pytest.mark.parametrize(
    "change",
    [
        lambda rotation: rotation.round(1),
        lambda rotation: rotation * [1, 1, 1.01],
        lambda rotation: rotation + [[0, 0.01, 0], [0, 0, 0], [0, 0, 0]],
        lambda rotation: -0.5 * rotation,
        lambda rotation: 0 * rotation,
        lambda rotation: 1e308 * rotation,
    ],
)
def test_other_scales_and_shear_are_refused(change):
    pose = random_pose(3)
    pose[:3, :3] = change(pose[:3, :3])
    with pytest.raises(InputError):
        rigid(pose, "file", "view", Mended())


def test_an_exact_rotation_is_not_mended():
    mended = Mended()
    assert np.array_equal(rigid(random_pose(5), "file", "view", mended), random_pose(5))
    assert not mended.notes(Path("file"))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda pose: pose * 2, "last row"),
        (lambda pose: np.diag([2.0, 2, 2, 1]) @ pose, "no rotation"),
        (lambda pose: pose @ np.diag([1.0, -1, 1, 1]), "mirrored"),
        (lambda pose: np.where(np.eye(4) > 0, np.nan, pose), "NaN"),
        (lambda pose: pose[:2], "shape (2, 4)"),
        (lambda pose: np.zeros((4, 4)) + np.diag([0, 0, 0, 1.0]), "no rotation"),
    ],
)
def test_what_is_no_pose_is_named(change, found):
    with pytest.raises(InputError) as caught:
        rigid(change(random_pose(3)), "poses.npy", "view7")
    assert found in str(caught.value)
    assert "poses.npy" in str(caught.value)
    assert "\n" not in str(caught.value)
