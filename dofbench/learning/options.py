"""Every choice of the trainer as one flat, validated set of options.

Times are shares of the whole training (0 ... 1), so a schedule keeps its shape under any budget;
the published schedules run over 30 000 iterations (DoF-Gaussian section 5, Mip-Splatting, 3DGS).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, GAMMA, Energy
from dofbench.learning.lens_ties import LensPer


@dataclass(frozen=True)
class TrainerOptions:
    """Options of the Gaussian trainer; `method.toml` presets and `--set key=value` name these.

    Length and size
        steps: length of the schedule. coarse_until, coarse_factor: train on images shrunk by the
        factor up to this share of the training. max_gaussians: density control stops adding there.
    Appearance
        sh_degree: highest spherical-harmonics degree; one degree is added every sh_every share.
        background: encoded grey level behind the scene.
    Filters
        filter_2d: Mip-Splatting's 2D filter, px^2 (0 switches it off). filter_3d: its 3D filter.
    Learning rates (3DGS names; means are scaled by the scene's extent)
        cooldown_from: share of the training from which all rates, the lens's too, fall linearly to
        cooldown_to of what they would be; 1 for never.
    Reconstruction loss (Eq. 7)
        ssim_weight: lambda. held_back: share of every photograph's tiles that no colour loss looks at, to score by
        (`held_back.py`). clipped_white: a prediction above a photograph's white costs nothing.
    Outliers (`outliers.py`)
        outlier_views: views whose loss stays far above the others' are left out, from the share outliers_from of
        the training on.
    Camera (`colours.py`)
        colour_per_view: a colour learned for every photograph, "gain" a factor a channel, "affine" a matrix and an
        offset. colour_lr: its rate; colour_lr_fall: factor on it at the end.
    Lens (section 4.1)
        lens: False trains a pinhole (`mipsplatting`). lens_gamma, lens_alpha, lens_energy: the
        forward model. lens_range: "points" fixes the disparity range once from the sparse points,
        "render" takes min and 95th percentile of each rendered view at each step (released code).
        lens_model: "scatter", the paper's, blurs the sharp rendering; "samples" rasterises the scene as seen from
        points of the lens, with the occlusion that comes with it, from lens_samples_from of the training on and in
        every rendering. lens_rings: of those points around the centre (1 + 3 k (k + 1) points), fewer where a
        photograph's circles don't need them; 0, and any number before lens_rings_from, blurs each Gaussian by its own
        circle of confusion, seen from the centre.
        lens_blades, lens_rotation: the opening, a polygon or with 0 a disc; "samples" knows discs only.
        lens_per: what photographs share (`lens_ties.py`): "view" nothing; "aperture" one aperture, with a focus each;
        "group" one aperture for each f-number; "exif" one aperture x f-number; "scene" the whole lens.
        lens_activation: what is learned of a lens: "relu" (released), "log" or "ends" (`lenses.py`).
        lens_trials: what is tried out while training, by what explains held-back pixels (`trials.py`): any of
        "lens" (is there one), "share" (do photographs share it) and "model" (the forward model), with commas.
        lens_trials_at, lens_trials_steps: when, and how long each way is tried: shares of the training.
        lens_update: "view" keeps Adam's moments of each view by its own visits, "dense" runs one
        Adam over the vectors (released). lens_lr, lens_lr_final: rate at the start and the end.
        lens_from: share of the training before which the lens stays as it was initialised.
        blur_to_depth: whether the blur's gradient reaches the geometry.
    Depth supervision (Eq. 9)
        depth_weight: w_d, 0 switches it off. depth_norm: "l1" or "l2"; depth_space: "depth" (scene
        units) or "disparity" (normalised); depth_decay: factor reached at the end, linearly.
        depth_prior: what supervises: "sparse" points; "stereo", our own on the photographs, and the
        points; a depth "network" as it is; one that is "tuned" to the scene by stereo depth and points (section 4.2);
        or "colmap", a dense workspace. depth_prior_file: the network, TorchScript; without it the
        shipped one. depth_prior_workspace: COLMAP's dense folder; "tuned" takes it in place of stereo.
        depth_prior_coarser: how often stereo looks again at half the size, where it found nothing.
        start_points: how many points on the prior's surfaces Gaussians start from, beside the sparse
        points (not with "sparse"), whatever depth_weight is.
        depth_prior_steps: of tuning, no more than the training's own. depth_prior_loss: Eq. 8,
        "squared" (printed) or "absolute" (released), either with the best scale a view.
    Normal consistency (Eq. 12)
        normal_weight: w_n, 0 switches it off. normal_from: share of training from which it acts.
        normal_median: share of the median depth's normals, the rest from the expected depth. normal_form: "splats"
        sums over a pixel's splats (Eq. 12), "pixel" compares its one normal of unit length (released code).
    Distortion (released code; not in the paper)
        distortion_weight: 0 switches it off. distortion_from: share of training from which it acts.
        distortion_near, distortion_far: scene units, the bounds of the depth's mapping to [0, 1].
    Defocus-to-focus adaptation (Eq. 10, 11, 13)
        adaptation: how the loss is weighted after adaptation_from: "off"; "psi", the printed Eq. 13;
        "one_minus_psi", what the text says and the released code does (on the L1 terms alone).
        adaptation_aperture: Eq. 11, A' = A psi. adaptation_a, adaptation_b: slope and threshold.
    Density control
        densify_from, densify_until: shares of the training; densify_every: steps. grow_gradient:
        threshold on the mean 2D gradient, in 3DGS's NDC unit. grow_absolute: sum absolute
        per-pixel gradients instead (AbsGS). dense_share: split above, clone below this share of
        the extent. clone_opacity: "keep" gives a clone its original's opacity (3DGS), which makes the
        two more opaque than the one was; "share" divides it so that the rendering hardly changes
        (Rota Bulo et al., Revising Densification in Gaussian Splatting). prune_opacity: remove below.
        prune_depth_graded: divide that threshold by 1 (nearest) ... 3 (farthest), as the released
        code does. reset_every: opacity reset interval,
        share of the training, 0 for never.
    """

    steps: int = 7000
    coarse_until: float = 0.0
    coarse_factor: int = 2
    max_gaussians: int = 1_000_000

    sh_degree: int = 3
    sh_every: float = 1 / 30
    background: float = 0.0

    filter_2d: float = 0.1
    filter_3d: bool = True

    means_lr: float = 1.6e-4
    means_lr_final: float = 1.6e-6
    sh_dc_lr: float = 2.5e-3
    sh_rest_lr: float = 1.25e-4
    opacity_lr: float = 0.05
    scale_lr: float = 5e-3
    rotation_lr: float = 1e-3
    cooldown_from: float = 1.0
    cooldown_to: float = 0.1

    ssim_weight: float = 0.2
    held_back: float = 0.0
    clipped_white: bool = False

    outlier_views: bool = False
    outliers_from: float = 0.3

    colour_per_view: Literal["off", "gain", "affine"] = "off"
    colour_lr: float = 1e-2
    colour_lr_fall: float = 0.1

    lens: bool = True
    lens_gamma: float = GAMMA
    lens_alpha: float = ALPHA
    lens_energy: Energy = "area"
    lens_range: Literal["points", "render"] = "points"
    lens_model: Literal["scatter", "samples"] = "scatter"
    lens_rings: int = 1
    lens_samples_from: float = 0.5
    lens_rings_from: float = 0.0
    lens_blades: int = 0
    lens_rotation: float = 0.0
    lens_per: LensPer = "view"
    lens_trials: str = ""
    lens_trials_at: float = 0.35
    lens_trials_steps: float = 0.03
    lens_activation: Literal["relu", "log", "ends"] = "relu"
    lens_update: Literal["view", "dense"] = "view"
    lens_lr: float = 5e-4
    lens_lr_final: float = 5e-4
    lens_from: float = 0.0
    lens_init_aperture: float = 0.5
    lens_init_focus: float = 0.5
    blur_to_depth: bool = False

    depth_weight: float = 0.01
    depth_norm: Literal["l1", "l2"] = "l2"
    depth_space: Literal["depth", "disparity"] = "depth"
    depth_decay: float = 0.1
    depth_prior: Literal["sparse", "stereo", "network", "tuned", "colmap"] = "sparse"
    depth_prior_file: str = ""
    depth_prior_workspace: str = ""
    depth_prior_coarser: int = 0
    depth_prior_steps: int = 150
    start_points: int = 0
    depth_prior_loss: Literal["squared", "absolute"] = "squared"

    normal_weight: float = 0.05
    normal_from: float = 0.0
    normal_median: float = 0.0
    normal_form: Literal["splats", "pixel"] = "splats"

    distortion_weight: float = 0.0
    distortion_from: float = 0.5
    distortion_near: float = 0.2
    distortion_far: float = 100.0

    adaptation: Literal["off", "psi", "one_minus_psi"] = "one_minus_psi"
    adaptation_from: float = 1 / 3
    adaptation_aperture: bool = False
    adaptation_a: float = 15.0
    adaptation_b: float = 0.3

    densify_from: float = 1 / 60
    densify_until: float = 0.5
    densify_every: int = 100
    grow_gradient: float = 2e-4
    grow_absolute: bool = False
    dense_share: float = 0.01
    clone_opacity: Literal["keep", "share"] = "keep"
    prune_opacity: float = 0.005
    prune_depth_graded: bool = False
    reset_every: float = 0.1

    def __post_init__(self) -> None:
        if self.lens_blades < 0 or self.lens_blades in (1, 2):
            raise InputError("option lens_blades", str(self.lens_blades), "0, a disc, or at least 3")
        if self.lens_model == "samples" and self.lens_blades:
            raise InputError("option lens_blades", f"{self.lens_blades} with lens_model=samples", "0: a disc")
        if self.lens_init_aperture <= 0:
            raise InputError(
                "option lens_init_aperture",
                str(self.lens_init_aperture),
                "more than 0: a closed lens blurs nothing, so nothing would open it",
            )
        if self.lens_range == "render" and self.lens_per not in ("view", "scene"):
            raise InputError(
                "option lens_per",
                f"{self.lens_per} with lens_range=render",
                "view or scene: an aperture in units of each view's own range can't be shared",
            )
        if not 0 <= self.held_back < 1:
            raise InputError("option held_back", str(self.held_back), "a share of 0 to below 1")
        unknown = sorted(set(filter(None, self.lens_trials.split(","))) - {"lens", "share", "model"})
        if unknown:
            raise InputError("option lens_trials", repr(unknown[0]), "some of lens, share, model, with commas")
        if self.lens_rings < 0:
            raise InputError("option lens_rings", str(self.lens_rings), "at least 0")
        if self.depth_prior_coarser < 0:
            raise InputError("option depth_prior_coarser", str(self.depth_prior_coarser), "at least 0")

    def cooldown(self, progress: float) -> float:
        """What all learning rates are multiplied by at `progress`, 0 to 1."""
        if progress <= self.cooldown_from:
            return 1.0
        return 1.0 - (1.0 - self.cooldown_to) * (progress - self.cooldown_from) / (1.0 - self.cooldown_from)

    def depth_factor(self, progress: float) -> float:
        """The weight of depth supervision at `progress`, 0 to 1: w_d, falling linearly (supplement; released code)."""
        return self.depth_weight * (1 - (1 - self.depth_decay) * progress)

    def with_overrides(self, overrides: Mapping[str, Any], subject: str = "option") -> TrainerOptions:
        """A copy with some options replaced; strings are converted to the option's type.

        Raises InputError for an unknown name or a value that doesn't fit.
        """
        hints = get_type_hints(TrainerOptions)
        known = {field.name for field in fields(self)}
        values = {}
        for name, value in overrides.items():
            if name not in known:
                raise InputError(f"{subject} {name}", "an unknown name", f"one of {', '.join(sorted(known))}")
            values[name] = _convert(f"{subject} {name}", value, hints[name])
        return replace(self, **values)


def _convert(subject: str, value: Any, kind: Any) -> Any:
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise InputError(subject, repr(value), f"one of {', '.join(get_args(kind))}")
        return value
    if kind is bool:
        words = {"true": True, "false": False, "1": True, "0": False}
        if isinstance(value, bool):
            return value
        if str(value).lower() not in words:
            raise InputError(subject, repr(value), "true or false")
        return words[str(value).lower()]
    try:
        converted = kind(value)
    except (TypeError, ValueError):
        raise InputError(subject, repr(value), f"a number ({kind.__name__})") from None
    if kind is int and float(value) != converted:
        raise InputError(subject, repr(value), "a whole number")
    return converted
