"""What the tests of learned blur share: one Gaussian, its photograph, and the models as the tests make them."""

from __future__ import annotations

import math

import torch
from made_up import Recorder, cloud, frontal
from small_scene import training_set

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.core.lens import DisparityRange
from dofbench.methods.bags.method import ProposalOptions, ProposedBlur
from dofbench.methods.cocogaussian.method import CircleCopies, CopiesOptions
from dofbench.methods.deblurring3dgs.method import EnlargedGaussians, EnlargingOptions
from dofbench.methods.gsplat_deblur.method import MaskedBlur, MaskOptions
from dofbench.training.gaussians.forward_model import SharpView, Shot
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.lens_renderer import StillRasteriser
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions

CAMERA = frontal(48, 36, 45.0, (0.0, 0.0, 0.0))
BARE = AppearanceOptions(filter_2d=0.0, filter_3d=False)
RANGE = DisparityRange(0.1, 1.0)
SHORT = {"steps": 90, "sh_degree": 1, "densify_from": 0.1, "densify_every": 20, "reset_every": 0.0}


def trained(kind: type[GaussianMethod], **options) -> GaussianMethod:
    method = kind({**SHORT, **options}, 0, "cpu")
    outcome = method.fit(training_set(), Budget(steps=90), Recorder())
    assert outcome.status is Status.OK and outcome.steps == 90, outcome.message
    return method


def shot(number: int | None = 0, slope: float = 0.0, offset: float = 0.0) -> Shot:
    return Shot(CAMERA, RANGE, slope, offset, number=number)


def one_gaussian(deviation: float, z: float = 4.0) -> StillRasteriser:
    """A round Gaussian of so many pixels on the axis, faint enough to stay below the largest alpha."""
    points = cloud([(0, 0, z), (0, 1, z), (1, 0, z), (1, 1, z)])
    gaussians = Gaussians.from_points(points, 0)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"][:] = torch.tensor([0.0, -30.0, -30.0, -30.0])
        gaussians.parameters["log_scales"][:] = math.log(deviation * z / 45.0)
        gaussians.parameters["sh_dc"][:] = 1.0
    return StillRasteriser(gaussians, BARE)


def no_view() -> SharpView:
    def refuse():
        raise AssertionError("the sharp view was looked at")

    return SharpView(refuse)


def enlarging(**options) -> EnlargedGaussians:
    return EnlargedGaussians(torch.zeros(3), 1.0, EnlargingOptions(**options), torch.Generator().manual_seed(0))


def with_outputs(blur: EnlargedGaussians, scales: float, turns: float) -> EnlargedGaussians:
    """The network gives these outputs, whatever it is asked."""
    with torch.no_grad():
        head = blur._network.head
        head.weight.zero_()
        head.bias[:3], head.bias[3:] = scales, turns
    return blur


def masked(**options) -> MaskedBlur:
    return MaskedBlur(enlarging(), 3, MaskOptions(**options), torch.Generator().manual_seed(0))


def copying(focus: float = 4.0, **options) -> CircleCopies:
    first = torch.tensor([focus, focus])
    return CircleCopies(first, torch.zeros(3), 2.0, CopiesOptions(**options), torch.Generator().manual_seed(0))


def proposing(width: int = 48, **options) -> ProposedBlur:
    return ProposedBlur([width, width], ProposalOptions(**options), torch.Generator().manual_seed(0))
