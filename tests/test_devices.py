"""What a device's name means and which one a call gets."""

from __future__ import annotations

import pytest

from dofbench.core.errors import InputError
from dofbench.runtime import devices


@pytest.fixture
def two_accelerators(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "count", lambda kind: 2 if kind == "cuda" else 1)


@pytest.fixture
def no_accelerator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "count", lambda kind: 0 if kind == "cuda" else 1)


def test_a_name_is_a_kind_and_perhaps_a_number() -> None:
    assert devices.kind_of("cpu") == "cpu" and devices.kind_of("cuda:1") == "cuda"


@pytest.mark.parametrize("name", ["tpu", "cuda:", "cuda:x", "", "CPU"])
def test_any_other_name_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="device: found"):
        devices.kind_of(name)


def test_auto_is_the_accelerator_where_there_is_one_that_serves(two_accelerators) -> None:
    assert devices.resolve("auto", ("cpu", "cuda"), "it") == "cuda"
    assert devices.resolve("auto", ("cpu",), "it") == "cpu"


def test_auto_is_the_cpu_where_there_is_none(no_accelerator) -> None:
    assert devices.resolve("auto", ("cpu", "cuda"), "it") == "cpu"
    assert devices.kinds_here() == ("cpu",)
    with pytest.raises(InputError, match="--device: found auto, and none of cuda here"):
        devices.resolve("auto", ("cuda",), "it")


def test_a_device_that_serves_and_is_there_is_taken_by_its_name(two_accelerators) -> None:
    assert devices.resolve("cuda:1", ("cpu", "cuda"), "it") == "cuda:1"
    assert devices.resolve("cpu", ("cpu", "cuda"), "it") == "cpu"


@pytest.mark.parametrize(
    ("wanted", "runs_on", "words"),
    [
        ("cuda", ("cpu",), "found 'cuda', expected auto or what it runs on: cpu"),
        ("tpu", ("cpu", "cuda"), "found 'tpu', expected auto or what it runs on: cpu, cuda"),
        ("cuda:x", ("cpu", "cuda"), "device: found 'cuda:x'"),
        ("cuda:2", ("cpu", "cuda"), "found 'cuda:2', and 2 of them here, expected auto or one of cpu, cuda"),
    ],
)
def test_any_other_is_one_line(two_accelerators, wanted: str, runs_on: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        devices.resolve(wanted, runs_on, "it")


def test_a_device_that_this_machine_lacks_is_one_line(no_accelerator) -> None:
    with pytest.raises(InputError, match="found 'cuda', and none here, expected auto or one of cpu"):
        devices.resolve("cuda", ("cpu", "cuda"), "it")
