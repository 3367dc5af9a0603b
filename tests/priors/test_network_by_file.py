"""A network by file as the prior, from the option to the depth of every pixel, on two small photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import FLOAT32_GRADIENT

from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.learning.priors import make_prior

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")


class Rows(torch.nn.Module):
    """Log depth 0 in the upper half and 1 in the lower one, whatever it is shown."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        rows = torch.arange(image.shape[2]).view(1, 1, -1, 1)
        return (rows >= image.shape[2] // 2).to(image.dtype) + 0 * image[:, :1]


def test_every_pixel_has_the_networks_depth_at_the_scale_of_the_points(tmp_path: Path) -> None:
    """Points at 4 in the upper half of both views, where the network says 1: all of it counts four times."""
    file = tmp_path / "rows.pt"
    torch.jit.script(Rows()).save(str(file))
    xyz = [((8.5 + 4 * place - 32) / 60 * 4, (10.5 - 32) / 60 * 4, 4.0) for place in range(5)]
    points = cloud(xyz, views=[np.array([0, 1])] * 5)
    image = np.full((64, 64, 3), 0.5, np.float32)
    views = tuple(TrainingView(name, frontal(64, 64, 60.0), image) for name in "ab")
    options = GaussianOptions.of(depth_prior="network", depth_prior_file=str(file)).prior
    prior = make_prior(TrainingSet(views, points), options, seed=0, steps=1)
    for index, view in enumerate(views):
        samples = prior.samples(index, view.camera)
        assert len(samples.depth) == 64 * 64
        depth = samples.depth.numpy().reshape(64, 64)
        assert np.allclose(depth[:30], 4.0, rtol=FLOAT32_GRADIENT)
        assert np.allclose(depth[34:], 4.0 * np.e, rtol=FLOAT32_GRADIENT)
