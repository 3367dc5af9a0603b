"""A method's card says where it runs; the harness holds it to that, and to what its kernels can do."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_method import METHOD_TOML, write_method
from made_up import Recorder, record_ops
from small_scene import noise

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.methods.cards import find_method, method_files
from dofbench.runtime import devices
from dofbench.runtime import ops as kernels


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


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_a_shipped_method_calls_no_kernel_that_its_card_leaves_out(name: str, monkeypatch) -> None:
    called = record_ops(monkeypatch)
    entry = find_method(name)
    method = entry.create({**entry.card.presets["smoke"], "steps": 3, "depth_prior": "stereo"}, 0, "cpu")
    method.fit(noise(), Budget(steps=3), Recorder())
    assert {"rasterize", "ssim", "stereo"} <= called <= set(entry.card.kernels)
