"""LensSelect, this project's own method: a learned lens whose model is selected on held-out pixels while training."""

from __future__ import annotations

from dofbench.training.gaussians.gaussian_method import GaussianMethod


class LensSelect(GaussianMethod):
    """What it takes from whom, and what is its own (docs/lensselect.md).

    In `dofbench/training`: the A/B checks for a lens, a shared lens and the lens's model (`gaussians/trials.py`); the
    lens and the scatter renderer of DoF-Gaussian (`common/lenses.py`, `gaussians/lens_models.py`); each Gaussian's own
    blur of DOF-GS and CoCoGaussian, and lens rays with occlusion by aperture samples, as fNeRF has them for fields
    (`gaussians/lens_models.py`, `gaussians/lens_pattern.py`); the start on stereo (`common/priors/stereo.py`); the loss
    of edges (`common/losses.py`).
    """
