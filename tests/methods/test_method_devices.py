"""A method's card says where it runs; the harness holds it to that, and to what its kernels can do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from harness_fakes import METHOD_TOML, write_method

from dofbench import kernels
from dofbench.compute import devices
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Budget, PointCloud, TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.running.method_cards import find_method, method_files


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that makes a method with such a card, on a machine with an accelerator."""
    monkeypatch.setattr(devices, "count", lambda kind: 1)

    def make(**entries: str):
        lines = "".join(f"{name} = {value}\n" for name, value in entries.items())
        toml = METHOD_TOML.replace('default_preset = "quick"\n', f'default_preset = "quick"\n{lines}')
        monkeypatch.setenv("DOFBENCH_METHODS", str(write_method(tmp_path / "methods", toml=toml)))
        return find_method("fake")

    return make


def test_auto_takes_the_accelerator_where_method_and_kernels_run_there(fake) -> None:
    assert fake(devices='["cpu", "cuda"]', kernels='["scatter"]').device_for("auto") == "cuda"


def test_a_method_without_a_word_about_devices_runs_on_the_cpu(fake) -> None:
    entry = fake()
    assert entry.device_for("auto") == "cpu"
    with pytest.raises(InputError, match="--device: found 'cuda', expected auto or what fake runs on: cpu"):
        entry.device_for("cuda")


def test_a_kernel_without_a_backend_there_is_named_before_anything_is_done(fake, monkeypatch) -> None:
    entry = fake(devices='["cpu", "cuda"]', kernels='["scatter", "ssim"]')
    monkeypatch.setattr(kernels, "runs_on", lambda op, device: op == "scatter")
    with pytest.raises(InputError, match="method fake on cuda: found kernel ssim without a backend there"):
        entry.device_for("cuda")


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"devices": '["tpu"]'}, "unknown device 'tpu'"),
        ({"kernels": '["blur"]'}, "method fake: found the kernel 'blur'"),
    ],
)
def test_a_card_that_names_what_is_not_there_is_refused(fake, entries, words) -> None:
    with pytest.raises(InputError, match=words):
        fake(**entries).device_for("cpu")


def test_every_shipped_method_can_run_where_its_card_says() -> None:
    for entry in map(find_method, method_files()):
        for device in entry.card.devices:
            for op in entry.card.kernels:
                kernels.require(op, device, entry.id)


class Silent:
    """An observer that never stops training."""

    def seconds(self) -> float:
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        pass


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_a_shipped_method_calls_no_kernel_that_its_card_leaves_out(name: str, monkeypatch) -> None:
    random = np.random.default_rng(1)
    xyz = np.stack([random.uniform(-2, 2, 300), random.uniform(-1.5, 1.5, 300), random.uniform(3, 6, 300)], axis=1)
    points = PointCloud(xyz, random.uniform(size=(300, 3)).astype(np.float32), np.zeros(300, np.float32))
    poses = [np.eye(4) for _ in range(2)]
    poses[1][0, 3] = 0.2
    views = tuple(
        TrainingView(
            str(i), Camera(40, 30, 40.0, 40.0, 20.0, 15.0, pose), random.uniform(size=(30, 40, 3)).astype(np.float32)
        )
        for i, pose in enumerate(poses)
    )
    called, function = set(), kernels._function
    monkeypatch.setattr(kernels, "_function", lambda op, *which: (called.add(op), function(op, *which))[1])
    entry = find_method(name)
    method = entry.create({**entry.card.presets["smoke"], "steps": 3, "depth_prior": "stereo"}, 0, "cpu")
    method.fit(TrainingSet(views, points), Budget(steps=3), Silent())
    assert {"rasterize", "ssim", "stereo"} <= called <= set(entry.card.kernels)
