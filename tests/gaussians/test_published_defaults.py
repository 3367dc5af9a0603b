"""Defaults of the options of a training: what was published is kept, what we added is off, and shares are shares.

The published figures are those of docs/published-methods.md, in the steps of the publications, of 30 000.
"""

from __future__ import annotations

from importlib import import_module

import pytest

from dofbench.methods.bags.method import ProposedOptions
from dofbench.methods.cocogaussian.method import CopiedOptions
from dofbench.methods.dofgs.method import FocusedOptions
from dofbench.methods.gsplat_deblur.method import MaskedOptions
from dofbench.methods.rgs.method import RobustOptions
from dofbench.training.common.options import listed_options
from dofbench.training.gaussians.gaussian_options import GaussianOptions

SplattingOptions = import_module("dofbench.methods.3dgs.method").SplattingOptions
OPTIONS = {option.name: option for option in listed_options(GaussianOptions)}
BLUR = {
    option.name: option
    for kind in (RobustOptions, MaskedOptions, CopiedOptions, ProposedOptions, FocusedOptions, SplattingOptions)
    for option in listed_options(kind)
    if option.name not in OPTIONS or kind is SplattingOptions
}
PROPOSED = {option.name: option for option in listed_options(ProposedOptions)}

# 3DGS, Kerbl et al. 2023, and its code.
THREE_DGS = {
    "means_lr": 0.00016,
    "means_lr_final": 0.0000016,
    "sh_dc_lr": 0.0025,
    "sh_rest_lr": 0.0025 / 20,
    "opacity_lr": 0.05,
    "scale_lr": 0.005,
    "rotation_lr": 0.001,
    "densify_from": 500 / 30_000,
    "densify_until": 15_000 / 30_000,
    "densify_every": 100,
    "grow_gradient": 0.0002,
    "dense_share": 1 / 100,
    "clone_opacity": "keep",
    "clone_place": "same",
    "prune_opacity": 1 / 200,
    "reset_every": 3_000 / 30_000,
    "reset_filtered": False,
    "sh_degree": 3,
    "sh_every": 1_000 / 30_000,
    "background": 0,
    "ssim_weight": 0.2,
}
# DoF-Gaussian's paper, its supplement and its released code.
DOF_GAUSSIAN = {
    "lens": True,
    "lens_lr": 0.0005,
    "lens_lr_final": 0.0005,
    "lens_init_aperture": 0.5,
    "lens_init_focus": 0.5,
    "lens_alpha": 4,
    "lens_gamma": 2.2,
    "depth_weight": 0.01,
    "depth_decay": 0.1,
    "depth_norm": "l2",
    "normal_weight": 0.05,
    "normal_from": 0,
    "normal_form": "splats",
    "distortion_from": 15_000 / 30_000,
    "adaptation_from": 10_000 / 30_000,
    "adaptation_a": 15,
    "adaptation_b": 0.3,
}
# What nobody has published, or not all have: neutral, so that only who asks for it gets it.
ADDED = {
    "coarse_until": 0,
    "cooldown_from": 1,
    "prune_depth_graded": False,
    "grow_absolute": False,
    "held_back": 0,
    "clipped_white": False,
    "outlier_views": False,
    "colour_per_view": "off",
    "blur_to_depth": False,
    "lens_blades": 0,
    "lens_rotation": 0,
    "lens_trials": "",
    "lens_per": "view",
    "lens_focus_from": "option",
    "depth_prior_coarser": 0,
    "start_points": 0,
    "distortion_weight": 0,
    "normal_median": 0,
    "adaptation_aperture": False,
    "lens_rings_from": 0,
}
# What docs/methods.md says: up to seven aperture samples; trials at 35 % of the training, for 3 % of its steps.
OWN = {"lens_rings": 1, "lens_trials_at": 35 / 100, "lens_trials_steps": 3 / 100}


# What the methods that learn another blur than a lens's publish, in their steps (docs/published-methods.md), and 3DGS
# where it differs from Mip-Splatting.
OTHER_BLUR = {
    "enlarge_from": 0,
    "enlarge_lambda": 0.01,
    "enlarge_most": 1.1,
    "enlarge_lr": 0.001,
    "extra_at": 2_500 / 20_000,
    "mask_lr": 0.001,
    "mask_cost": 0.002,
    "copies": 4,
    "copies_from": 1_500 / 30_000,
    "copies_lr": 0.001,
    "copies_lr_final": 1 / 100,
    "proposal_from": 0.008,  # of 30 000 steps, 250 rounded down
    "proposal_lr": 0.0005,
    "proposal_cost": 0.001,
    "quarter_until": 3_000 / 30_000,
    "coarse_until": 6_000 / 30_000,
    "filter_2d": 0.3,
    "filter_3d": False,
    "prune_scale": 0.1,
    "noise_lr": 500_000,
    "opacity_cost": 0.01,
    "scale_cost": 0.01,
    "init_opacity": 0.5,
    "init_scale": 0.1,
}
# Ours: points are added and Gaussians sampled only where that is asked for; the rest is stated at the option.
OTHER_OWN = {
    "extra_points": 0,
    "extra_within": 10,
    "mcmc": False,
    "focus_lr": 0.01,
    "proposal_width": 16,
    "view_blur_init": 1,
    "view_blur_lr": 0.02,
    "in_focus_weight": 0.5,
    "in_focus_circle": 0.5,
    # Parts that presets switch on, off where presets were fixed without them.
    "restart_at": 0,
    "depth_variation": 0,
    "colour_variation": 0,
    "mixing_width": 16,
    "focus_network": False,
    "focus_network_lr": 0.001,
}


@pytest.mark.parametrize(("name", "value"), [*OTHER_BLUR.items(), *OTHER_OWN.items()])
def test_a_default_of_another_blur_is_what_was_published(name: str, value: float) -> None:
    default = PROPOSED[name].default if name == "coarse_until" else BLUR[name].default
    assert default == pytest.approx(value)


@pytest.mark.parametrize(("name", "value"), [*THREE_DGS.items(), *DOF_GAUSSIAN.items(), *ADDED.items(), *OWN.items()])
def test_a_default_is_what_was_published(name: str, value: float | str) -> None:
    default = OPTIONS[name].default
    assert default == (value if isinstance(value, str) else pytest.approx(value))


def test_every_figure_of_3dgs_is_compared() -> None:
    assert {name for name, option in OPTIONS.items() if "3DGS" in option.source} == THREE_DGS.keys()


def test_shares_of_the_training_and_steps_can_be_that() -> None:
    for name, option in OPTIONS.items():
        if option.unit.startswith("share"):
            assert 0 <= float(str(option.default)) <= 1, name
        if option.unit == "steps":
            assert int(str(option.default)) > 0, name
