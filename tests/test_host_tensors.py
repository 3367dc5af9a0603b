"""Computations stay on the device of their tensors: no tensor is moved to the CPU, or made there, without a reason.

Read from the sources, without running anything: in `dofbench.optics`, `learning`, `gaussians` and `fields`, and in the
kernels' definitions. Each place that may do so is listed in `ALLOWED` under its reason, with the number of occurrences;
an entry that is no longer needed must be removed, so that the list can only shrink. The test doesn't detect
`float(tensor)`, which looks like `float` of a number, nor tensors made by functions elsewhere.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("optics", "learning", "gaussians", "fields")

# Each brings a tensor's numbers to the host.
FETCHES = {"numpy", "cpu", "item", "tolist"}
# Copies to a device, and waits until the device has done all that it was asked before; `beside` doesn't.
WAITS = "new_tensor"
# Each makes a tensor, on the CPU where no device is named.
MAKES = {"arange", "as_tensor", "empty", "eye", "from_numpy", "full", "linspace", "logspace", "ones", "rand", "randint"}
MAKES |= {"randn", "randperm", "tensor", "zeros"}

NUMPY_FACE = "NumPy arrays in and out: what datasets are written with and photographs compared with"
OPENCV = "OpenCV cuts and continues the layers, on the host and without a gradient"
FILES = "a reader or a writer"
PHOTOGRAPHS = "where photographs, points and depth maps of a dataset, NumPy arrays, become tensors"
NEIGHBOURS = "the tree that neighbours are searched in is scipy's: once in a training"
PRIOR = "depth priors come and go as NumPy arrays: sweeps, networks and checks run once, before training"
FIRST = "a network's first numbers: drawn on the host, so that devices begin alike, then moved with the network"
NUMBERS = "a few numbers of the kind that options and reports hold: nothing of the size of an image"

ALLOWED: dict[str, dict[str, int]] = {
    NUMPY_FACE: {
        "optics defocus_by_radius: .numpy()": 4,
        "optics defocus_by_radius: torch.from_numpy": 2,
        "optics defocus_light: .numpy()": 2,
        "optics defocus_light: torch.from_numpy": 2,
        "gaussians Exposures.render: .numpy()": 2,
        "gaussians Reconstruction.surface: .numpy()": 3,
        "fields FieldScene.render: .numpy()": 2,
        "fields through_points: .numpy()": 1,
    },
    OPENCV: {
        "optics _composited: torch.from_numpy": 3,
        "optics layered_blur: .numpy()": 3,
        "optics layered_blur: torch.from_numpy": 1,
    },
    FILES: {
        "learning write_colours: .tolist()": 1,
        "learning LearnedLenses.state: .numpy()": 1,
        "learning LearnedColours.matrix: .numpy()": 1,
        "gaussians Gaussians.load: torch.from_numpy": 1,
        "gaussians Gaussians.save: .numpy()": 2,
        "gaussians read_splats.columns: torch.from_numpy": 1,
        "gaussians write_splats: .numpy()": 2,
        "fields FieldMethod.save: .numpy()": 2,
    },
    PHOTOGRAPHS: {
        "learning held_back_mask: torch.from_numpy": 1,
        "learning DepthMap.samples: torch.from_numpy": 4,
        "learning sparse_depth: torch.from_numpy": 3,
        "gaussians Gaussians.from_points: torch.from_numpy": 2,
        "gaussians Reconstruction.surface: torch.from_numpy": 1,
        "gaussians Trainer.photograph: .numpy()": 1,
        "fields TrainingPixels.check: torch.from_numpy": 1,
    },
    NEIGHBOURS: {"gaussians _nearest: .numpy()": 2},
    PRIOR: {
        "learning with_surface_points: .numpy()": 4,
        "learning with_surface_points: torch.from_numpy": 1,
        "learning AlignedOnnx.forward: .numpy()": 1,
        "learning AlignedOnnx.forward: torch.from_numpy": 1,
        "learning _aligned: .numpy()": 4,
        "learning _photograph: torch.from_numpy": 1,
        "learning DepthMap.with_samples: .numpy()": 3,
        "learning DepthSamples.on: .numpy()": 2,
        "learning all_disparities: .numpy()": 1,
        "learning disparity_bounds: .numpy()": 1,
        "learning LogDepth.__init__: torch.tensor": 3,
        "learning _scene_scale: .numpy()": 4,
        "learning _scene_scale: torch.tensor": 2,
        "learning network_input: torch.from_numpy": 1,
        "learning predicted_depth: .numpy()": 4,
        "learning _agreed: .numpy()": 1,
        "learning _at_size: .numpy()": 1,
        "learning _sweep: .numpy()": 1,
        "learning _target: .numpy()": 5,
        "learning _target: torch.zeros": 2,
        "learning tune: .tolist()": 1,
    },
    FIRST: {
        "fields KernelNetwork.__init__: torch.randn": 1,
        "fields KernelNetwork.__init__: torch.zeros": 1,
        "fields _MotionNetwork.__init__: torch.randn": 1,
    },
    NUMBERS: {
        "gaussians foci_apart: torch.tensor": 1,
        "gaussians widest_circle: .numpy()": 1,
        "gaussians rings_for: .tolist()": 1,
        "learning rendered_range: .numpy()": 1,
        "learning Watch.look: .tolist()": 1,
        "ssim gaussian_window: .tolist()": 1,
        "ssim gaussian_window: torch.arange": 1,
    },
}


def sources() -> dict[str, Path]:
    """Path below the root -> file."""
    found = {}
    for package in PACKAGES:
        for file in sorted((ROOT / "dofbench" / package).rglob("*.py")):
            found[str(file.relative_to(ROOT))] = file
    for file in sorted((ROOT / "kernels").glob("*/reference.py")):
        found[str(file.relative_to(ROOT))] = file
    return found


def places(name: str, text: str) -> Iterator[str]:
    """`package function: call` of every such call in a module; a method or an inner function with what it is in.

    The module isn't named, so that a function may move within its package.
    """
    package, tree = name.split("/")[1], ast.parse(text)
    moved = {id(node.func.value) for node in ast.walk(tree) if isinstance(node, ast.Call) and moves(node)}

    def walk(node: ast.AST, inside: tuple[str, ...]) -> Iterator[str]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inside = (*inside, node.name)
        if isinstance(node, ast.Call) and id(node) not in moved and (call := fetch_or_make(node)):
            yield f"{package} {'.'.join(inside) or 'the module'}: {call}"
        for child in ast.iter_child_nodes(node):
            yield from walk(child, inside)

    yield from walk(tree, ())


def moves(node: ast.Call) -> bool:
    """Whether it is `made.to(other)` or `made.to(device=...)`, which puts what was made where it belongs."""
    if not isinstance(node.func, ast.Attribute) or node.func.attr != "to":
        return False
    return any(keyword.arg == "device" for keyword in node.keywords) or any(
        not (isinstance(one, ast.Attribute) and isinstance(one.value, ast.Name) and one.value.id == "torch")
        for one in node.args
    )


def fetch_or_make(node: ast.Call) -> str:
    """`.numpy()`, `.new_tensor()` or `torch.zeros`, if the call is one without a device; else ""."""
    function = node.func
    if not isinstance(function, ast.Attribute):
        return ""
    of_torch = isinstance(function.value, ast.Name) and function.value.id == "torch"
    if of_torch and function.attr in MAKES:
        # `**options` may contain a device, which can't be checked here.
        named = any(keyword.arg in ("device", None) for keyword in node.keywords)
        return "" if named else f"torch.{function.attr}"
    fetches = function.attr in FETCHES and not node.args and not of_torch
    return f".{function.attr}()" if fetches or function.attr == WAITS else ""


def found() -> Counter[str]:
    return Counter(place for name, file in sources().items() for place in places(name, file.read_text()))


def allowed() -> Counter[str]:
    """The places of the list; one under two reasons counts twice."""
    return sum((Counter(group) for group in ALLOWED.values()), Counter())


def test_no_tensor_goes_to_the_cpu_or_is_made_there_but_where_a_reason_is_given() -> None:
    new = found() - allowed()
    assert not new, (
        f"{dict(new)}: keep to the device of the tensors at hand (device=tensor.device, beside), or say in "
        "ALLOWED why the host is right there"
    )


def test_the_list_holds_nothing_that_is_not_there_any_more() -> None:
    assert not (gone := allowed() - found()), f"take these off ALLOWED: {dict(gone)}"


@pytest.mark.parametrize(
    ("text", "call"),
    [
        ("def f(x):\n    return x.detach().numpy()", ".numpy()"),
        ("def f(x):\n    return x.sum().item()", ".item()"),
        ("def f(x):\n    return x.cpu()", ".cpu()"),
        ("def f(x):\n    return torch.zeros(())", "torch.zeros"),
        ("def f(x):\n    return torch.arange(3, dtype=x.dtype)", "torch.arange"),
        ("def f(x):\n    return torch.from_numpy(x)", "torch.from_numpy"),
        ("def f(x):\n    return torch.ones(3).to(torch.float64)", "torch.ones"),
    ],
)
def test_each_is_seen(text: str, call: str) -> None:
    assert list(places("dofbench/optics/a.py", text)) == [f"optics f: {call}"]
    inner = "class A:\n" + "\n".join(f"    {line}" for line in text.splitlines())
    assert list(places("dofbench/optics/a.py", inner)) == [f"optics A.f: {call}"]


@pytest.mark.parametrize(
    "text",
    ["torch.zeros(3, device=x.device)", "torch.zeros(3, **to)", "x.new_zeros(3)", "torch.ones(3).to(x)", "np.zeros(3)"],
)
def test_what_names_a_device_is_fine(text: str) -> None:
    assert list(places("dofbench/optics/a.py", text)) == []
