"""DP-NeRF's rigid blurring kernel (Lee et al., CVPR 2023, section 4.1): all pixels of a photograph are mixed from the
same few rigid motions of their rays, by weights of the photograph's own and by weights that are proposed for each
pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from dofbench.training.common.networks import rectified, redraw
from dofbench.training.fields.forward.blur_kernels import KernelOptions, LearnedKernel
from dofbench.training.fields.forward.mixed_rays import mixed
from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.forward.weight_proposal import WeightProposal, WeightProposalOptions
from dofbench.training.fields.pixels import Pixels, TrainingPixels

_EMBEDDING, _WIDTH, _HIDDEN, _SKIP, _BRANCH = 64, 64, 4, 4, 32
_SCALE = 0.1  # of rotations (radians) and translations (units of depth) against the network's output
_FIRST = 1e-5  # the motions' last layers begin this close to no motion
_LEAST_ANGLE = 1e-10


class RigidKernel(LearnedKernel):
    """A `RayModel`. centre: (3,) the world point that rotations turn about. unit: the depth, scene units, that counts
    as 1 in translations. channels: what the field stores at a point (`GridOptions.feature_count`), by which weights are
    proposed. The first of a pixel's rays is its own, the others are moved."""

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

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs, fewer by the number of rays that each is mixed from."""
        return photographs.draw(count if progress < self._options.kernel_from else count // self._options.kernel_points)

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The mixture of what the moved rays see, by the photograph's weights and by proposed ones."""
        origins, directions = scene.cameras.rays(pixels.views, pixels.places)
        if progress < self._options.kernel_from:
            return [Prediction(scene.trace(origins, directions).color)]
        rotation, velocity, weights, about = self._network()
        turn, slide = screw_motion(rotation.reshape(-1, 3), velocity.reshape(-1, 3) * self._unit)
        turn, slide = (moves.view(*rotation.shape[:2], *moves.shape[1:])[pixels.views] for moves in (turn, slide))
        from_centre = (origins - self._centre)[:, None, :, None]
        moved = (turn @ from_centre)[..., 0] + slide + self._centre, (turn @ directions[:, None, :, None])[..., 0]
        starts, ways = (
            torch.cat([own[:, None], others], 1).view(-1, 3)
            for own, others in zip((origins, directions), moved, strict=True)
        )
        colours = scene.trace(starts, ways).color.view(len(origins), -1, 3)
        by_photograph = mixed(colours, weights[pixels.views])
        if self._proposal is None:
            return [Prediction(by_photograph)]
        samples = scene.features_along(starts, ways, self._own.proposal_samples)
        proposed = self._proposal(
            samples.view(*colours.shape[:2], *samples.shape[1:]),
            about[pixels.views],
            torch.nn.functional.normalize(directions, dim=1),
        )
        share = self._own.share(progress, self._options.kernel_from)
        return [Prediction(by_photograph, 1 - share), Prediction(mixed(colours, proposed), share)]


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
    """From a photograph's embedding to its motions and weights."""

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
        """Of all photographs: rotations (V, M, 3), velocities (V, M, 3), weights (V, M + 1) that add up to 1, and what
        they were made from, (V, W)."""
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
