"""What the rasteriser on a GPU says of arguments that it can't draw."""

from __future__ import annotations

import math

import pytest
import torch
from random_gaussians import NAMES, scene, view

from dofbench.runtime.ops import load

gpu = load("rasterize", "gpu")


@pytest.mark.parametrize("name", [*NAMES, "filter_3d", "blur"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_parameter_is_named(name: str, value: float) -> None:
    gaussians = {**scene(20, 17), "filter_3d": torch.full((20,), 0.1), "blur": torch.full((20,), 0.1)}
    gaussians["means"][:, 2] = 4
    gaussians["opacity_logits"][:] = 1
    gaussians[name].view(20, -1)[13, 0] = value
    if name == "opacity_logits" and value == math.inf:
        assert torch.isfinite(gpu(**gaussians, camera=view()).color).all()
        return
    with pytest.raises(FloatingPointError, match=rf"{name}\[13\]"):
        gpu(**gaussians, camera=view())


def test_a_projection_that_overflows_is_told() -> None:
    gaussians = scene(5, 17)
    gaussians["means"][3] = torch.tensor([0.0, 0.0, 4.0])
    gaussians["log_scales"][3] = 60.0
    with pytest.raises(FloatingPointError, match="Gaussian 3: its projection overflows float32"):
        gpu(**gaussians, camera=view())


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("means", torch.zeros(4, 2), r"means: expected shape \(4, 3\), found \(4, 2\)"),
        ("quaternions", torch.zeros(4, 4).double(), "quaternions: expected contiguous torch.float32"),
        ("sh_dc", torch.zeros(3, 4).T, "sh_dc: expected contiguous torch.float32 on cpu, found not contiguous"),
        ("sh_rest", torch.zeros(4, 5, 3), "sh_rest: expected shape"),
        ("filter_3d", torch.zeros(3), r"filter_3d: expected shape \(4,\)"),
        ("background", torch.zeros(3, requires_grad=True), "background: expected a tensor without gradient"),
        ("blur", torch.tensor([0.0, 1.0, -0.5, 2.0]), "blur: expected at least 0, found -0.5"),
        ("geometry", "depths", "geometry: expected one of none, depth, full, distortion, found 'depths'"),
        ("sh_degree", 4, "sh_degree: expected 0, 1, 2 or 3, found 4"),
        ("filter_2d", -0.1, "filter_2d: expected at least 0"),
        ("near", 0.0, "near: expected more than 0"),
    ],
)
def test_wrong_arguments_say_so(name: str, value: object, found: str) -> None:
    arguments = {**scene(4, 18), "camera": view(), name: value}
    with pytest.raises(ValueError, match=found):
        gpu(**arguments)
