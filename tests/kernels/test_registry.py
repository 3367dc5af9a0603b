"""Which backend a call uses: found by its file, chosen by the tensors, or selected by name."""

from __future__ import annotations

import sys
from importlib import invalidate_caches
from pathlib import Path

import pytest
import torch
from called import imported_by

from dofbench.core.errors import InputError
from dofbench.runtime import ops as kernels

OP = """
from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["{op}", "twice"]


def {op}(values: Tensor, *, other: Tensor | None = None, backend: str = AUTO) -> str:
    return implementation("{op}", backend, values=values, other=other).{op}(values)


def twice(values: Tensor, *, backend: str = AUTO) -> str:
    return implementation("{op}", backend, values=values).twice(values)
"""
REFERENCE = """
from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu",), dtypes=("float64", "float32"), bits_repeat=False)


def {op}(values):
    return "reference"


def twice(values):
    return "twice by the reference"
"""
META = """
from dofbench.runtime.backend import Backend

warmed = []
BACKEND = Backend(
    devices=("meta",), dtypes=("float32",), bits_repeat=True, warm_up=lambda **options: warmed.append(options),
    is_warm=lambda: bool(warmed),
)


def {op}(values):
    return "meta"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of two more ops: `lone` has the reference alone, `both` a backend for torch's meta tensors too."""
    shared = {"op": OP, "reference": REFERENCE}
    for op, files in (("lone", shared), ("both", shared | {"meta": META})):
        (tmp_path / op).mkdir()
        for name, text in files.items():
            (tmp_path / op / f"{name}.py").write_text(text.format(op=op))
    (tmp_path / "both" / "meta_part.py").write_text("raise AssertionError('a part is no backend')")
    (tmp_path / "not_an_op").mkdir()
    monkeypatch.setattr(kernels, "__path__", [*kernels.__path__, str(tmp_path)])
    caches = kernels.backends, kernels._module, kernels._suiting
    for cached in caches:
        cached.cache_clear()
    invalidate_caches()
    yield tmp_path
    for cached in caches:
        cached.cache_clear()
    for name in list(sys.modules):
        if name.startswith(("dofbench.runtime.ops.lone", "dofbench.runtime.ops.both")):
            del sys.modules[name]


def test_ops_and_backends_are_found_by_their_files(folder: Path) -> None:
    assert set(kernels.ops()) >= {"both", "lone", "rasterize", "scatter", "ssim", "stereo", "tone"}
    assert "not_an_op" not in kernels.ops()
    assert kernels.backends("both") == ("meta", "reference") and kernels.backends("lone") == ("reference",)


def test_finding_imports_no_backend() -> None:
    script = "from dofbench.runtime import ops\nassert {ops.backends(op) for op in ops.ops()}"
    assert not {name.split(".")[0] for name in imported_by(script)} & {"torch", "numba", "numpy"}


@pytest.mark.parametrize("op", kernels.ops())
def test_every_backend_declares_itself_and_has_all_functions(op: str) -> None:
    assert kernels.functions(op)[0] == op
    for name in kernels.backends(op):
        backend = kernels.backend_of(op, name)
        assert backend.devices and set(backend.dtypes) <= {"float64", "float32", "float16", "bfloat16"}
        assert all(callable(getattr(kernels._module(op, name), function)) for function in kernels.functions(op))
    assert "float64" in kernels.backend_of(op, "reference").dtypes
    assert kernels.backend_of(op, "cpu").bits_repeat


@pytest.mark.parametrize("op", kernels.ops())
def test_only_a_gpu_gets_backends_of_that_name(op: str) -> None:
    """What a result depends on is told by the name (dofbench/core/source_digest.py)."""
    for name in kernels.backends(op):
        assert (name == "gpu") == ("cpu" not in kernels.backend_of(op, name).devices)


@pytest.mark.parametrize(
    ("op", "values", "expected"),
    [
        ("both", torch.zeros(2, device="meta"), "meta"),
        ("both", torch.zeros(2), "reference"),
        ("both", torch.zeros(2).double(), "reference"),
        ("lone", torch.zeros(2), "reference"),
    ],
)
def test_the_tensors_choose(folder: Path, op: str, values: torch.Tensor, expected: str) -> None:
    assert kernels.load(op)(values) == expected
    assert kernels.load(op)(values=values, other=values) == expected


def test_a_name_overrides_the_choice(folder: Path) -> None:
    assert kernels.load("both", "reference")(torch.zeros(2)) == "reference"
    assert kernels.load("both", function="twice")(torch.zeros(2)) == "twice by the reference"


def test_float64_goes_to_the_definition_and_float32_to_the_kernel() -> None:
    values = torch.linspace(0.1, 1, 7)
    tone, arguments = kernels.load("tone"), (2.2, 0.01, 0.01**1.2)
    assert torch.equal(tone(values, *arguments), kernels.load("tone", "cpu")(values, *arguments))
    assert not torch.equal(tone(values, *arguments), kernels.load("tone", "reference")(values, *arguments))
    exact = tone(values.double(), *arguments)
    assert torch.equal(exact, kernels.load("tone", "reference")(values.double(), *arguments))


def test_tensors_that_no_backend_takes_are_refused_in_one_line(folder: Path) -> None:
    with pytest.raises(InputError, match="kernel lone: found tensors of float32 on meta, expected reference: float64"):
        kernels.load("lone")(torch.zeros(2, device="meta"))
    with pytest.raises(InputError, match="meta: float32 on meta; reference: float64, float32 on cpu"):
        kernels.load("both")(torch.zeros(2, dtype=torch.float16))
    with pytest.raises(InputError, match="kernel both, backend meta: found float32 on cpu, expected float32 on meta"):
        kernels.load("both", "meta")(torch.zeros(2))


@pytest.mark.parametrize("other", [torch.zeros(2, device="meta"), torch.zeros(2).double()])
def test_tensors_on_two_devices_or_of_two_types_are_refused(folder: Path, other: torch.Tensor) -> None:
    expected = f"both other: expected torch.float32 on cpu like values, found {other.dtype} on {other.device}"
    with pytest.raises(ValueError, match=expected):
        kernels.load("both")(torch.zeros(2), other=other)


def test_unknown_names_are_one_line() -> None:
    with pytest.raises(InputError, match="kernel: found 'blur', expected one of adam, colours, field, mix, rasteri"):
        kernels.load("blur")
    with pytest.raises(InputError, match="backend of kernel ssim: found 'npu', expected one of auto, cpu, gpu, ref"):
        kernels.load("ssim", "npu")
    with pytest.raises(InputError, match="function of kernel ssim: found 'mse', expected one of l1_ssim, ssim"):
        kernels.load("ssim", function="mse")


def test_a_caller_can_ask_whether_an_op_runs_on_a_device(folder: Path) -> None:
    assert kernels.runs_on("both", "meta") and not kernels.runs_on("lone", "meta")
    kernels.require("both", "meta", "method x")
    with pytest.raises(InputError, match="method x on meta: found kernel lone without a backend there"):
        kernels.require("lone", "meta", "method x")
    with pytest.raises(InputError, match="method x: found the kernel 'blur'"):
        kernels.require("blur", "cpu", "method x")


def test_the_warm_up_is_that_of_the_backend_that_would_be_called(folder: Path) -> None:
    assert not kernels.is_warm("both", "meta")
    kernels.warm_up("both", "meta", form="linear")
    assert kernels.is_warm("both", "meta")
    assert sys.modules["dofbench.runtime.ops.both.meta"].warmed == [{"form": "linear"}]
    kernels.warm_up("both")  # the reference has nothing to compile
    assert kernels.is_warm("both")


@pytest.mark.parametrize("op", kernels.ops())
def test_after_its_warm_up_a_kernel_is_warm(op: str) -> None:
    kernels.warm_up(op)
    assert kernels.is_warm(op)
