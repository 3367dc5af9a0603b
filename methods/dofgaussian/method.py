"""DoF-Gaussian (Shen et al., CVPR 2025): Gaussian splatting through a learnable thin lens for every view."""

from __future__ import annotations

from dofbench.training.gaussians.gaussian_method import GaussianMethod


class DoFGaussian(GaussianMethod):
    """Equations 1 to 13 of the paper. They are in the shared trainer, since other methods use parts of them.

    In `dofbench/training`: lens, Eq. 5 (`common/lenses.py`); scatter renderer, Algorithm 1
    (`gaussians/lens_models.py`); colour loss, Eq. 7, and adaptation, Eq. 10, 11 and 13 (`common/losses.py`); depth
    priors, Eq. 8 (`common/priors`); depth loss, Eq. 9 (`common/depth.py`); normals, Eq. 12
    (`gaussians/surface_losses.py`).
    """
