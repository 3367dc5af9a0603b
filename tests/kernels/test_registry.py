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

REFERENCE = """
from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu",), dtypes=("float64", "float32"), bits_repeat=False)


def {op}(values, *, other=None):
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


def {op}(values, *, other=None):
    return "meta"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of two more ops: `lone` has the reference alone, `both` a backend for torch's meta tensors too."""
    for op, files in (("lone", {"reference": REFERENCE}), ("both", {"reference": REFERENCE, "meta": META})):
        (tmp_path / op).mkdir()
        for name, text in files.items():
            (tmp_path / op / f"{name}.py").write_text(text.format(op=op))
    (tmp_path / "both" / "meta_part.py").write_text("raise AssertionError('a part is no backend')")
    (tmp_path / "not_an_op").mkdir()
    monkeypatch.setattr(kernels, "__path__", [*kernels.__path__, str(tmp_path)])
    invalidate_caches()
    yield tmp_path
    for name in [
        name for name in sys.modules if name.startswith(("dofbench.runtime.ops.lone", "dofbench.runtime.ops.both"))
    ]:
        del sys.modules[name]


def test_ops_and_backends_are_found_by_their_files(folder: Path) -> None:
    assert set(kernels.ops()) >= {"both", "lone", "rasterize", "scatter", "ssim", "stereo", "tone"}
    assert "not_an_op" not in kernels.ops()
    assert kernels.backends("both") == ("meta", "reference") and kernels.backends("lone") == ("reference",)


def test_finding_imports_no_backend() -> None:
    script = (
        "from dofbench import kernels\nassert {kernels.backends(op) for op in kernels.ops()}\nkernels.load('scatter')"
    )
    assert not {name.split(".")[0] for name in imported_by(script)} & {"torch", "numba", "numpy"}


@pytest.mark.parametrize("op", kernels.ops())
def test_every_backend_declares_itself_and_has_the_op(op: str) -> None:
    for name in kernels.backends(op):
        backend = kernels.backend_of(op, name)
        assert backend.devices and set(backend.dtypes) <= {"float64", "float32", "float16", "bfloat16"}
        assert callable(kernels.load(op, name))
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
    assert kernels.load(op)(values=values, other=3) == expected


def test_a_name_overrides_the_choice(folder: Path) -> None:
    assert kernels.load("both", "meta")(torch.zeros(2)) == "meta"
    assert kernels.load("both", function="twice")(torch.zeros(2)) == "twice by the reference"


def test_float64_goes_to_the_definition_and_float32_to_the_kernel() -> None:
    values = torch.linspace(0.1, 1, 7)
    tone, arguments = kernels.load("tone"), (2.2, 0.01, 0.01**1.2)
    assert torch.equal(tone(values, *arguments), kernels.load("tone", "cpu")(values, *arguments))
    assert not torch.equal(tone(values, *arguments), kernels.load("tone", "reference")(values, *arguments))
    exact = tone(values.double(), *arguments)
    assert torch.equal(exact, kernels.load("tone", "reference")(values.double(), *arguments))


@pytest.mark.parametrize(
    ("op", "arguments", "words"),
    [
        ("lone", (torch.zeros(2, device="meta"),), "kernel lone: found tensors of float32 on meta, expected what a"),
        ("both", (torch.zeros(2, dtype=torch.float16),), "meta: float32 on meta; reference: float64, float32 on cpu"),
        ("lone", (3,), "no tensor"),
    ],
)
def test_what_no_backend_takes_is_one_line_that_says_what_each_does(folder, op, arguments, words) -> None:
    with pytest.raises(InputError, match=words):
        kernels.load(op)(*arguments)


def test_tensors_on_two_devices_are_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="kernel both: found tensors on cpu and meta, expected all on one"):
        kernels.load("both")(torch.zeros(2), other=torch.zeros(2, device="meta"))
    with pytest.raises(InputError, match="kernel both: found tensors on cpu and meta, expected all on one"):
        kernels.load("both")([torch.zeros(2), torch.zeros(2, device="meta")])


def test_tensors_in_a_sequence_choose(folder: Path) -> None:
    assert kernels.load("both")([torch.zeros(2, device="meta")]) == "meta"


def test_a_folder_that_is_added_later_is_looked_at(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although the choice for such tensors was made before."""
    assert kernels.load("lone")(torch.zeros(2)) == "reference"
    other = folder / "other" / "lone"
    other.mkdir(parents=True)
    (other / "another.py").write_text(META.format(op="lone").replace('"meta"', '"cpu"'))
    monkeypatch.setattr(kernels, "__path__", [*kernels.__path__, str(other.parent)])
    invalidate_caches()
    assert kernels.load("lone")(torch.zeros(2)) == "cpu"


def test_unknown_names_are_one_line() -> None:
    with pytest.raises(InputError, match="kernel: found 'blur', expected one of adam, colours, field, mix, rasteri"):
        kernels.load("blur")
    with pytest.raises(InputError, match="backend of kernel ssim: found 'npu', expected auto or one of cpu, gpu, ref"):
        kernels.load("ssim", "npu")


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
