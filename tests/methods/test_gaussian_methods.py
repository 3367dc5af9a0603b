"""The shipped methods through the contract that the harness uses."""

import numpy as np
import pytest

from dofbench.cameras import Camera
from dofbench.contracts import Budget, PointCloud, TrainingSet, TrainingView
from dofbench.errors import InputError
from dofbench.harness.methods import find_method
from dofbench.lens import PhysicalLens

CAMERA = Camera(40, 30, 40.0, 40.0, 20.0, 15.0, np.eye(4))
LENS = PhysicalLens(aperture=8.0, focus_disparity=0.2, width=40)


class Silent:
    """An observer that never stops training."""

    def seconds(self):
        return 0.0

    def after_step(self, step, loss):
        return True


@pytest.fixture(scope="module")
def training_set():
    random = np.random.default_rng(1)
    xyz = np.stack([random.uniform(-2, 2, 300), random.uniform(-1.5, 1.5, 300), random.uniform(3, 6, 300)], axis=1)
    points = PointCloud(xyz, random.uniform(size=(300, 3)).astype(np.float32), np.zeros(300, np.float32))
    image = random.uniform(size=(30, 40, 3)).astype(np.float32)
    shifted = np.eye(4)
    shifted[0, 3] = 0.2
    other = Camera(40, 30, 40.0, 40.0, 20.0, 15.0, shifted)
    return TrainingSet((TrainingView("a", CAMERA, image), TrainingView("b", other, image)), points)


def _trained(name, training_set, **options):
    entry = find_method(name)
    method = entry.create({**entry.card.presets["smoke"], "steps": 6, **options}, 0, "cpu")
    method.fit(training_set, Budget(steps=6), Silent())
    return entry, method


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_a_saved_method_renders_the_same_bits(name, training_set, tmp_path):
    entry, method = _trained(name, training_set)
    method.save(tmp_path)
    again = entry.create({**entry.card.presets["smoke"], "steps": 6}, 0, "cpu")
    again.load(tmp_path)
    lens = LENS if entry.card.capabilities.refocus else None
    before, after = method.render(CAMERA, lens), again.render(CAMERA, lens)
    assert np.array_equal(before.image, after.image) and np.array_equal(before.depth, after.depth)
    assert again.lens_estimates() == method.lens_estimates()
    assert again.describe() == method.describe()


def test_the_lens_blurs_and_all_in_focus_does_not(training_set):
    _, method = _trained("dofgaussian", training_set)
    sharp, blurred = method.render(CAMERA, None).image, method.render(CAMERA, LENS).image
    assert np.abs(np.diff(blurred, axis=1)).mean() < np.abs(np.diff(sharp, axis=1)).mean()
    assert set(method.lens_estimates()) == {"a", "b"}


def test_a_method_without_a_lens_says_so(training_set):
    _, method = _trained("mipsplatting", training_set)
    assert method.lens_estimates() is None
    with pytest.raises(ValueError, match="can't refocus"):
        method.render(CAMERA, LENS)


def test_what_a_method_fixes_can_not_be_set():
    entry = find_method("mipsplatting")
    with pytest.raises(InputError, match="this method fixes it"):
        entry.create({"lens": True}, 0, "cpu")


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_every_preset_names_known_options(name):
    entry = find_method(name)
    for preset in entry.card.presets:
        entry.create(entry.preset(preset)[1], 0, "cpu")


def test_no_points_is_the_users_mistake(training_set):
    entry = find_method("dofgaussian")
    method = entry.create(entry.card.presets["smoke"], 0, "cpu")
    with pytest.raises(InputError, match="sparse points"):
        method.fit(TrainingSet(training_set.views, None), Budget(steps=1), Silent())
