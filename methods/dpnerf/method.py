"""DP-NeRF (Lee et al., CVPR 2023): a rigid blurring kernel (section 4.1). All pixels of a view are mixed from the same
few rigid motions of their rays, by weights of the view and by weights proposed for each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from dofbench.core.contracts import TrainingSet
from dofbench.training.common.networks import rectified, redraw
from dofbench.training.fields.blur_kernels import KernelFieldOptions, KernelOptions, LearnedKernel, unit_of_depth
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.pixels import Pixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer, mixed

from .weight_proposal import WeightProposal, WeightProposalOptions

_EMBEDDING, _WIDTH, _HIDDEN, _SKIP, _BRANCH = 64, 64, 4, 4, 32
_SCALE = 0.1  # of rotations (radians) and translations (units of depth) against the network's output
_FIRST = 1e-5  # the motions' last layers begin this close to no motion
_LEAST_ANGLE = 1e-10


class RigidKernel(LearnedKernel):
    """Mixes pixels from rigidly moved rays; the first of a pixel's rays is its own.

    centre: (3,) the world point that rotations turn about. unit: the depth, scene units, that counts as 1 in
    translations. channels: of the field's features at a point (`GridOptions.feature_count`), for the proposal.
    """

    def __init__(
        self,
        views: int,
        centre: np.ndarray,
        unit: float,
        channels: int,
        options: KernelOptions,
        own: WeightProposalOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._centre, self._unit, self._own = torch.from_numpy(centre.astype(np.float32)).to(device), unit, own
        self._network = _MotionNetwork(views, options.kernel_points - 1, generator).to(device)
        self._proposal = None
        parameters = dict(self._network.named_parameters())
        if own.weight_proposal:
            self._proposal = WeightProposal(options.kernel_points, channels, _WIDTH, generator).to(device)
            parameters |= {f"proposal.{name}": value for name, value in self._proposal.named_parameters()}
        super().__init__(parameters.items(), options)

    def mix(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The mixture by the view's weights, and that by proposed ones."""
        origins, directions = tracer.cameras.rays(pixels.views, pixels.places)
        rotation, velocity, weights, about = self._network()
        turn, slide = screw_motion(rotation.reshape(-1, 3), velocity.reshape(-1, 3) * self._unit)
        turn, slide = (moves.view(*rotation.shape[:2], *moves.shape[1:])[pixels.views] for moves in (turn, slide))
        from_centre = (origins - self._centre)[:, None, :, None]
        moved = (turn @ from_centre)[..., 0] + slide + self._centre, (turn @ directions[:, None, :, None])[..., 0]
        starts, ways = (
            torch.cat([own[:, None], others], 1).view(-1, 3)
            for own, others in zip((origins, directions), moved, strict=True)
        )
        colours = tracer.trace(starts, ways).color.view(len(origins), -1, 3)
        by_view = mixed(colours, weights[pixels.views])
        if self._proposal is None:
            return [Prediction(by_view)]
        samples = tracer.scene.features_along(starts, ways, self._own.proposal_samples)
        proposed = self._proposal(
            samples.view(*colours.shape[:2], *samples.shape[1:]),
            about[pixels.views],
            torch.nn.functional.normalize(directions, dim=1),
        )
        share = self._own.share(progress, self._options.kernel_from)
        return [Prediction(by_view, 1 - share), Prediction(mixed(colours, proposed), share)]


def screw_motion(rotation: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (V, 3, 3) and translations (V, 3) of screw motions: the exponential map of SE(3) (Lynch and Park,
    Modern Robotics, Eq. 3.88), as in Nerfies.

    rotation: (V, 3), axis times angle, radians. velocity: (V, 3), the translation per radian, times the angle.
    """
    angle = (rotation.square().sum(1, keepdim=True) + _LEAST_ANGLE**2).sqrt()
    axis, along = rotation / angle, velocity / angle
    zero = torch.zeros_like(axis[:, 0])
    x, y, z = axis.unbind(1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3)
    square, angle = cross @ cross, angle[:, :, None]
    unit = torch.eye(3, dtype=axis.dtype, device=axis.device).expand_as(cross)
    turn = unit + torch.sin(angle) * cross + (1 - torch.cos(angle)) * square
    reach = angle * unit + (1 - torch.cos(angle)) * cross + (angle - torch.sin(angle)) * square
    return turn, (reach @ along[:, :, None])[:, :, 0]


class _MotionNetwork(nn.Module):
    """From a view's embedding to its motions and weights."""

    def __init__(self, views: int, motions: int, generator: torch.Generator):
        super().__init__()
        self._motions = motions
        self.embedding = nn.Parameter(torch.randn(views, _EMBEDDING, generator=generator))
        inputs = [_EMBEDDING, *[_WIDTH] * (_HIDDEN - 1)]
        inputs[_SKIP - 1] += _EMBEDDING
        self.hidden = nn.ModuleList(nn.Linear(width, _WIDTH) for width in inputs)
        self.rotation, self.velocity = _branch(3 * motions), _branch(3 * motions)
        self.weights = _branch(motions + 1)
        redraw(self, generator)
        with torch.no_grad():
            for branch in (self.rotation, self.velocity):
                for parameter in branch[-1].parameters():
                    parameter.uniform_(-_FIRST, _FIRST, generator=generator)

    def forward(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of all views: rotations (V, M, 3), velocities (V, M, 3), weights (V, M + 1) with sum 1, and the features
        (V, W) from which they were made."""
        features: Tensor = self.embedding
        for number, layer in enumerate(self.hidden, 1):
            if number == _SKIP:
                features = torch.cat([features, self.embedding], 1)
            features = rectified(layer, features)
        rotation, velocity = (
            _SCALE * branch(features).view(-1, self._motions, 3) for branch in (self.rotation, self.velocity)
        )
        weights = torch.sigmoid(self.weights(features))
        return rotation, velocity, weights / weights.sum(1, keepdim=True), features


def _branch(count: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(_WIDTH, _BRANCH), nn.ReLU(), nn.Linear(_BRANCH, count))


@dataclass(frozen=True)
class RigidFieldOptions(KernelFieldOptions):
    """Options of a field with rigid blurring kernels."""

    proposal: WeightProposalOptions = WeightProposalOptions()


class DPNeRF(FieldMethod):
    """A field without a lens; in training, pixels are mixed from rigid motions of their rays."""

    OPTIONS = RigidFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """See `RigidKernel`; rotations turn about the mean camera centre."""
        options = self._options
        assert isinstance(options, RigidFieldOptions)
        centre = np.mean([view.camera.centre for view in training_set.views], axis=0)
        views, unit, channels = len(training_set.views), unit_of_depth(training_set), options.grid.feature_count
        return RigidKernel(views, centre, unit, channels, options.kernel, options.proposal, generator, self._device)
