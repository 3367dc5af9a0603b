"""Gradients in float32 against the float64 reference, by direction and by magnitude; near kinks and away from them.

Each bound comes from the problem's condition: how much the exact gradient changes when every input is rounded once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial

import numpy as np
import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.evaluation.stability.case import DOUBLE, SINGLE, Case, Found, Setting, Subject
from dofbench.evaluation.stability.comparisons import l1_ssim
from dofbench.evaluation.stability.deviation import gradient_at, values
from dofbench.evaluation.stability.gradients_adam import adam
from dofbench.evaluation.stability.oracle import POWER
from dofbench.evaluation.stability.samples import VIEW_WIDTH, gaussians, harmonic, single, straight, together
from dofbench.evaluation.stability.samples import disparity as _disparity
from dofbench.evaluation.stability.samples import picture as _picture
from dofbench.evaluation.stability.samples import radii as _radii
from dofbench.optics.defocus import scatter_defocus

Inputs = dict[str, np.ndarray]
Loss = Callable[[Setting, dict[str, Tensor]], Tensor]
EPS = float(np.finfo(np.float32).eps)
HEIGHT_WIDTH = (14, 18)
picture, disparity = partial(_picture, *HEIGHT_WIDTH), partial(_disparity, *HEIGHT_WIDTH)
radii = partial(_radii, height=HEIGHT_WIDTH[0], width=HEIGHT_WIDTH[1])
# The effect of a gradient is its length times its input's largest number. A gradient whose effect is below this share
# of the largest effect is measured relative to that share.
LEAST = 1e-3
# The compiled scatter truncates a sharp pixel's edge at a weight of exp(-18); a neighbour one pixel away has exp(-8). A
# gradient from such neighbours alone lacks a share of exp(-10).
TAIL = math.exp(-10.0)
# The gradient with respect to a sharp pixel's radius is the difference of its colour and the blurred colour. These
# differ by the light of four neighbours, 4 exp(-8) / (1 / 2), so leading digits cancel. Four operations of one eps.
CANCELLED = 4 * EPS / (8 * math.exp(-8.0))


def gradient(setting: Setting, inputs: Inputs, loss: Loss) -> Inputs:
    """The loss's gradient with respect to every input, float64 on the host; zeros for an input without a gradient."""
    tensors = {name: setting.tensor(value, gradient=True) for name, value in inputs.items()}
    loss(setting, tensors).backward()
    return {
        name: np.zeros(tensor.shape) if tensor.grad is None else values(tensor.grad) for name, tensor in tensors.items()
    }


def apart(found: np.ndarray, exact: np.ndarray, least: float) -> float:
    """The larger of the angle between two gradients, radians, and the relative difference of their lengths.

    For an exact gradient shorter than `least`, the length of the difference as a share of `least`.
    """
    a, b = float(np.linalg.norm(found)), float(np.linalg.norm(exact))
    if not math.isfinite(a):
        return math.inf
    if b <= least:
        return float(np.linalg.norm(found - exact)) / least if least > 0 else (0.0 if a == b else math.inf)
    # From the distance of unit vectors, because a small angle's cosine loses half of its digits.
    chord = float(np.linalg.norm(found / max(a, 1e-300) - exact / b))
    return max(2 * math.asin(min(1.0, chord / 2)), abs(a / b - 1))


@dataclass(frozen=True, eq=False)
class Problem:
    """A loss of some inputs. extra: added to the bound; compiled: added to the bound of compiled kernels.

    whole: inputs that aren't rounded for the condition number, because the case needs exactly equal values.
    """

    inputs: Inputs
    loss: Loss
    extra: float = 0.0
    compiled: float = 0.0
    whole: tuple[str, ...] = ()

    @cached_property
    def given(self) -> Inputs:
        """The inputs rounded to float32."""
        return {name: value.astype(np.float32).astype(np.float64) for name, value in self.inputs.items()}

    @cached_property
    def exact(self) -> Inputs:
        """The gradient in float64."""
        return gradient(DOUBLE, self.given, self.loss)

    @cached_property
    def least(self) -> dict[str, float]:
        """For each input, the length below which a gradient is measured relative to this length."""
        size = {name: float(np.abs(value).max(initial=1.0)) for name, value in self.given.items()}
        most = max(float(np.linalg.norm(self.exact[name])) * size[name] for name in size)
        return {name: LEAST * most / size[name] for name in size}

    @cached_property
    def moved(self) -> dict[str, float]:
        """For each input, the change of its gradient, by `apart`, when all inputs are rounded once to float32."""
        moved = dict.fromkeys(self.given, 0.0)
        for draw in range(2):
            random = np.random.default_rng(draw)
            rounded = {
                name: value if name in self.whole else value * (1 + EPS / 2 * random.choice((-1.0, 1.0), value.shape))
                for name, value in self.given.items()
            }
            again = gradient(DOUBLE, rounded, self.loss)
            for name in moved:
                moved[name] = max(moved[name], min(1.0, apart(again[name], self.exact[name], self.least[name])))
        return moved

    def compared(self, setting: Setting) -> Found:
        """The worst input's gradient in float32 against the reference's in float64."""
        found, exact = gradient(setting, self.given, self.loss), self.exact
        worst, ratio = Found(0.0, 0.0), -1.0
        for name in found:
            bound = 8 * self.moved[name] + 64 * EPS + self.extra
            bound += self.compiled if setting.backend != "reference" else 0.0
            error = apart(found[name], exact[name], self.least[name])
            if not error <= ratio * bound:
                worst, ratio = Found(error, bound, self._note(name, found[name])), error / bound
        return worst

    def _note(self, name: str, found: np.ndarray) -> str:
        exact, least = self.exact[name], self.least[name]
        condition = f"condition {2 * self.moved[name] / EPS:.3g}"
        lengths = float(np.linalg.norm(found)), float(np.linalg.norm(exact))
        if lengths[1] <= least:
            return f"by {name}: of next to no effect, {lengths[0]:.3g} for {lengths[1]:.3g}, {condition}"
        cosine = float((found * exact).sum()) / max(lengths[0] * lengths[1], 1e-300)
        return f"by {name}: cosine 1 - {max(0.0, 1 - cosine):.2g}, magnitude {lengths[0] / lengths[1]:.7g}, {condition}"


# ---- losses ----


def _weights(shape: tuple[int, ...], seed: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def scatter_loss(setting: Setting, inputs: dict[str, Tensor], alpha: float = 4.0) -> Tensor:
    """The blurred image, summed with random weights."""
    blurred = setting.kernel("scatter")(inputs["image"], inputs["radius"], alpha=alpha)
    return (blurred * setting.tensor(_weights(tuple(blurred.shape)))).sum()


def defocus_loss(setting: Setting, inputs: dict[str, Tensor], gamma: float = 2.2) -> Tensor:
    """The decoded, blurred and encoded image, summed with random weights."""
    blurred = scatter_defocus(inputs["image"], inputs["radius"], Blur(gamma), backend=setting.backend)
    return (blurred * setting.tensor(_weights(tuple(blurred.shape)))).sum()


def raster_loss(setting: Setting, inputs: dict[str, Tensor], geometry: str = "full") -> Tensor:
    """Colour, alpha and the other outputs of `geometry`, with depth times alpha, summed with random weights."""
    raster = setting.kernel("rasterize")(**inputs, camera=straight(), geometry=geometry)
    parts = [raster.color, raster.alpha[..., None]]
    if raster.depth is not None:
        parts.append((raster.depth * raster.alpha.detach())[..., None])
    if raster.normal is not None:
        parts.append(raster.normal)
    drawn = torch.cat(parts, dim=2)
    return (drawn * setting.tensor(_weights(tuple(drawn.shape)))).sum()


def points_loss(setting: Setting, inputs: dict[str, Tensor]) -> Tensor:
    """The views of three aperture samples, summed with random weights."""
    points = np.array([[0.0, 0.6], [-0.5, -0.3], [0.5, -0.3]])
    views = setting.kernel("rasterize", "rasterize_from_points")(**inputs, camera=straight(), points=points)
    return (views * setting.tensor(_weights(tuple(views.shape)))).sum()


def photograph_loss(setting: Setting, inputs: dict[str, Tensor]) -> Tensor:
    """3DGS' loss of an image blurred by the signed CoC radii 8 (slope d + offset)."""
    radius = 8.0 * (inputs["slope"] * inputs["disparity"] + inputs["offset"])
    found = scatter_defocus(setting.tensor(picture()), radius, backend=setting.backend)
    return l1_ssim(setting, found, setting.tensor(_photograph()))


@cache
def _photograph() -> np.ndarray:
    radius = DOUBLE.tensor(radii(0.3, 8.0))
    return values(scatter_defocus(DOUBLE.tensor(picture()), radius, backend="reference"))


def _of_itself(setting: Setting) -> Found:
    image = setting.tensor(picture(), gradient=True)
    ssim_loss(setting, {"image": image}, picture()).backward()
    # In units of one pixel's share of the mean. The slope of 1 - SSIM is a rounding error over variances plus 9e-4.
    return Found(float(np.abs(gradient_at(image)).max()) * image.numel(), 64 * setting.eps / 9e-4)


def ssim_loss(setting: Setting, inputs: dict[str, Tensor], target: np.ndarray, edge_weight: float = 0.0) -> Tensor:
    """3DGS' loss against a target, plus `edge_weight` times the error of edges."""
    return l1_ssim(setting, inputs["image"], setting.tensor(target), edge_weight)


# ---- scenes at the kinks ----


def _threshold(opacity: float) -> Inputs:
    """A Gaussian with this alpha at its centre, on a pixel's centre, in front of another Gaussian."""
    # The 2D filter of 0.1 px^2 reduces the opacity, which is compensated here; 1.5 scene units are 12 px at this depth.
    variance = (1.5 * VIEW_WIDTH / 4.0) ** 2
    share = math.sqrt((variance / (variance + 0.1)) ** 2 + 1e-6)
    logit = math.log(opacity / share / (1 - opacity / share))
    return _before_another(scale=1.5, logit=logit)


def _footprint(determinant: float) -> Inputs:
    """A Gaussian whose footprint has this determinant, px^4 (drawn from 1e-6), in front of another Gaussian."""
    return _before_another(scale=determinant**0.25 * 4.0 / VIEW_WIDTH, logit=6.0)


def _before_another(scale: float, logit: float) -> Inputs:
    """A Gaussian on a pixel's centre, and one of another colour behind it."""
    middle = 0.5 * 4.0 / VIEW_WIDTH
    return together(
        single(mean=(middle, middle, 4.0), scale=scale, logit=logit),
        single(mean=(0.1, 0.0, 6.0), scale=0.9, logit=0.3, colour=(0.2, 0.8, 0.4)),
    )


def _stack(count: int) -> Inputs:
    """Layers of opacity 0.6: the transmittance is 1.05e-4 after ten, so the eleventh isn't drawn."""
    layers = [
        single(mean=(0.0, 0.0, 4.0 + 0.2 * k), scale=30.0, logit=math.log(1.5), colour=(0.1 + 0.08 * k, 0.5, 0.9))
        for k in range(count)
    ]
    return together(*layers)


def _dark(colour: float) -> Inputs:
    """Gaussians whose colours are at this distance from the clamp at 0."""
    scene = _threshold(0.5)
    scene["sh_dc"][0] = harmonic(colour)
    return scene


def _ten_deep() -> Inputs:
    """Ten Gaussians at one depth."""
    scene = gaussians(10, rest=0)
    scene["means"][:, 2] = 4.0
    return scene


# ---- a hundred steps ----

STEPS = 100
_RATES = {
    "means": 4e-3,
    "log_scales": 1e-2,
    "quaternions": 2e-3,
    "opacity_logits": 5e-2,
    "sh_dc": 1e-2,
    "slope": 5e-3,
    "offset": 5e-3,
}


def train(setting: Setting, *, off: float = 0.0, steps: int = STEPS) -> np.ndarray:
    """The loss of each step of a small training of Gaussians and their lens by Adam.

    off: relative error of the initial values.
    """
    view = straight(10, 8)
    random = np.random.default_rng(11)
    truth = gaussians(10, seed=3, rest=0)
    with torch.no_grad():
        drawn = DOUBLE.kernel("rasterize")(**{name: DOUBLE.tensor(value) for name, value in truth.items()}, camera=view)
        target = values(
            scatter_defocus(drawn.color, 2.5 * (1 / drawn.depth.clamp_min(1.0) - 0.25) * 4, backend="reference")
        )
    start: Inputs = {**gaussians(10, seed=3, rest=0), "slope": np.array(1.0), "offset": np.array(-0.5)}
    start["means"] = start["means"] + 0.1 * random.normal(size=(10, 3)).astype(np.float32)
    start["sh_dc"] = start["sh_dc"] * 0.3
    start = {
        name: value.astype(np.float32).astype(np.float64) * (1 + off * random.choice((-1.0, 1.0), value.shape))
        for name, value in start.items()
    }
    tensors = {name: setting.tensor(value, gradient=True) for name, value in start.items()}
    adam = torch.optim.Adam(
        [{"params": [tensor], "lr": _RATES.get(name, 0.0)} for name, tensor in tensors.items()], eps=1e-15
    )
    scene = [name for name in tensors if name not in ("slope", "offset")]
    photograph, losses = setting.tensor(target), []
    for _ in range(steps):
        raster = setting.kernel("rasterize")(**{name: tensors[name] for name in scene}, camera=view)
        near = 4 * (1 / raster.depth.detach().clamp_min(1.0))
        image = scatter_defocus(
            raster.color, 2.5 * (tensors["slope"] * near + 2 * tensors["offset"]), backend=setting.backend
        )
        loss = l1_ssim(setting, image, photograph)
        losses.append(float(loss.detach()))
        adam.zero_grad()
        loss.backward()
        adam.step()
    return np.array(losses)


@cache
def _trained_exactly(off: float) -> np.ndarray:
    return train(DOUBLE, off=off)


def _hundred_steps(setting: Setting) -> Found:
    exact = _trained_exactly(0.0)
    rounded = _trained_exactly(setting.eps / 2)
    found = train(setting)
    error, moved = float(np.abs(found / exact - 1).max()), float(np.abs(rounded / exact - 1).max())
    # Each step adds independent rounding errors, so a hundred steps add up to ten times one.
    note = f"loss {exact[0]:.4f} to {exact[-1]:.4f}, here {found[-1]:.4f}; rounded once at the start {moved:.2g}"
    return Found(error, 8 * math.sqrt(STEPS) * moved + 64 * setting.eps, note)


def _blur(
    radius: np.ndarray, light: np.ndarray | None = None, *, cancelled: bool = False, alpha: float = 4.0
) -> Problem:
    inputs = {"image": picture() if light is None else light, "radius": radius}
    return Problem(inputs, partial(scatter_loss, alpha=alpha), CANCELLED * cancelled, TAIL)


def _raster(scene: Inputs, geometry: str = "full", whole: tuple[str, ...] = ()) -> Problem:
    return Problem(scene, partial(raster_loss, geometry=geometry), whole=whole)


def _points(circle: float, scene: Inputs) -> Problem:
    count = len(scene["means"])
    signs = np.random.default_rng(4).choice((-1.0, 1.0), count)
    return Problem({**scene, "radius": circle * signs, "blur": np.full(count, 0.1 * circle**2)}, points_loss)


def _lens(aperture: float, focus: float) -> Problem:
    inputs = {"slope": np.array(aperture), "offset": np.array(-aperture * focus), "disparity": disparity()}
    return Problem(inputs, photograph_loss, 0.0, TAIL + 8 * POWER)


def _alike(found: np.ndarray, target: np.ndarray, edges: float = 0.0) -> Problem:
    return Problem({"image": found}, partial(ssim_loss, target=target, edge_weight=edges))


def _problems() -> dict[str, dict[str, Problem]]:
    """By subject and name of the case."""
    image, bright, dark = picture(), picture(), picture()
    bright[8, 9], dark[4:9, 4:12] = 1e6, 0
    near_focus = np.random.default_rng(2).choice((-1.0, 1.0), HEIGHT_WIDTH)
    integers = np.random.default_rng(3).choice((1.0, 2.0, 3.0, 5.0, 10.0), HEIGHT_WIDTH)
    return {
        "scatter": {
            "scatter-away-from-kinks": _blur(radii(0.48)),
            "scatter-depth-is-focus": _blur(np.zeros(HEIGHT_WIDTH), cancelled=True),
            "scatter-focus-1e-6": _blur(1e-6 * near_focus, cancelled=True),
            "scatter-focus-1e-3": _blur(1e-3 * near_focus, cancelled=True),
            "scatter-rim-on-pixels": _blur(integers),
            "scatter-rim-on-pixels-alpha-1e4": _blur(integers, alpha=1e4),
            "scatter-alpha-100": _blur(radii(0.48), alpha=100.0),
            "scatter-huge": _blur(radii(0.48, 40.0)),
            "scatter-highlight": _blur(radii(0.48), bright),
        },
        "defocus": {
            f"display-black-gamma-{gamma:g}": Problem(
                {"image": dark, "radius": radii(0.5)}, partial(defocus_loss, gamma=gamma), 0.0, TAIL + 8 * POWER
            )
            for gamma in (1.0, 2.2, 4.0)
        },
        "scatter of a lens": {
            "lens-start": _lens(0.5, 0.5),
            "lens-nearly-closed": _lens(0.01, 0.5),
            "lens-focus-far-off": _lens(1.0, 2.0),
            "lens-found": _lens(1.0 + 1e-3, 0.3 + 1e-3),
        },
        "rasterize": {
            "raster-away-from-kinks": _raster(_threshold(0.4)),
            "raster-random": _raster(gaussians(rest=15)),
            "raster-alpha-above-threshold": _raster(_threshold(1 / 255 * (1 + 1e-4))),
            "raster-alpha-below-threshold": _raster(_threshold(1 / 255 * (1 - 1e-4))),
            "raster-alpha-below-clamp": _raster(_threshold(0.99 * (1 - 1e-5))),
            "raster-alpha-above-clamp": _raster(_threshold(0.99 * (1 + 1e-5))),
            "raster-footprint-above": _raster(_footprint(1e-6 * (1 + 1e-3))),
            "raster-footprint-below": _raster(_footprint(1e-6 * (1 - 1e-3))),
            "raster-transmittance": _raster(_stack(12)),
            "raster-colour-above-clamp": _raster(_dark(1e-5)),
            "raster-colour-below-clamp": _raster(_dark(-1e-5)),
            "raster-one-depth": _raster(_ten_deep(), whole=("means",)),
            "raster-needle": _raster(single(scale=(3.0, 0.03, 0.03), quaternion=(0.9, 0.1, 0.2, 0.3)), "depth"),
            "points-in-focus": _points(0.0, gaussians(rest=15)),
            "points-blurred": _points(3.0, gaussians(rest=15)),
            "points-far-out": _points(40.0, gaussians(rest=0)),
        },
        "ssim": {
            "ssim-away": _alike(image, picture(seed=1)),
            "edges-away": _alike(image, picture(seed=1), edges=4.0),
            "ssim-close": _alike(image, image + 1e-4 * _weights(image.shape)),
            "ssim-flat": _alike(np.full_like(image, 0.5), np.full_like(image, 0.501)),
        },
    }


def _cases() -> tuple[Case, ...]:
    found = [
        Subject("gradients", subject.split()[0], SINGLE).case(name, problem.compared)
        for subject, problems in _problems().items()
        for name, problem in problems.items()
    ]
    ssim, rasterize = (Subject("gradients", subject, SINGLE) for subject in ("ssim", "rasterize"))
    return (*found, ssim.case("ssim-same", _of_itself), rasterize.case("hundred-steps", _hundred_steps), *adam())


CASES = _cases()
