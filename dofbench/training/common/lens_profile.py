"""The lens that explains how much more one photograph is blurred than another: a profile over its aperture.

For a patch at normalised disparity u in view i and v in view j, with apertures a and foci F, `blur_pairs` measured the
variance [s_i a_i (u - F_i)]^2 - k^2 [s_j a_j (v - F_j)]^2, where s is 1 % of the width (half a radius) and k the
patch's size in view i for that in view j. Differences say nothing of a blur that all views share: of a surface at one
disparity alone the aperture isn't determined, nor without views that are focused differently or nearly sharp
somewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.lens import COC_FRACTION, DisparityRange
from dofbench.training.common.blur_pairs import BlurPairs
from dofbench.training.common.lenses import Ties

APERTURES = np.geomspace(0.03, 6.0, 16)  # of the profile; 1 is a circle of 2 % of the width
FACTORS = np.geomspace(0.35, 2.8, 9)  # from the shared aperture to a view's own, tried first
FOCI = np.linspace(-0.5, 1.5, 41)  # normalised disparity, tried first
SWEEPS = 4
BINS = 8  # of disparity, with as many patches each
STEPS = 8  # of Gauss-Newton
PROFILE = np.geomspace(0.25, 4.0, 23)  # factors on the best apertures
RESAMPLINGS = 100
ALIKE = 0.5  # difference of costs that counts as none: a standard deviation, if patches were independent
DETERMINED = 0.25  # largest relative standard deviation of an aperture that is a number
FEWEST = 50  # patches
MOST = 12000  # patches: more are thinned out
# Against the truth, errors are this many times those of resampled views, and no smaller than the floors: relative, of
# the aperture, and of the focus. A texture, or a disc of many pixels, has the same bias in all its patches, which more
# views of one aperture average out.
WIDER, FLOORS, FLOORS_EACH = 1.7, (0.1, 0.03), (0.2, 0.05)
TURNED = 0.3  # normalised disparity between a view's foci, alone and with the shared aperture, that is too much
SHARP = 0.6  # share of the views whose own aperture must be determined
APART = 1.2  # views have apertures of their own if they differ by so many times the variance of their errors


@dataclass(frozen=True, eq=False)
class MeasuredLenses:
    """What the patches say of the views' lenses.

    aperture: (V,) normalised. foci: (V,) normalised disparity. aperture_error, focus_error: (V,) standard deviations,
    of the aperture relative to it; infinite where too few patches show the view. each: whether views have apertures of
    their own. low, high: 68 % interval of the views' median aperture. patches: how many were compared.
    """

    aperture: np.ndarray
    foci: np.ndarray
    aperture_error: np.ndarray
    focus_error: np.ndarray
    each: bool
    low: float
    high: float
    patches: int

    @property
    def determined(self) -> bool:
        """Whether the aperture is known well enough to be a number."""
        return float(np.log(self.high / self.low) / 2) <= DETERMINED

    def __str__(self) -> str:
        """In a line, the aperture as a number only if it is determined."""
        interval = f"68 % between {self.low:.2f} and {self.high:.2f} by {self.patches} patches in two photographs each"
        if not self.determined:
            return f"aperture not determined: {interval}"
        what = "of each photograph, median" if self.each else "of all photographs, median"
        return f"aperture {what} {np.median(self.aperture):.2f}, {interval}"


@dataclass(frozen=True, eq=False)
class _Patches:
    """u, v: normalised disparities in the first and the second view. mine, theirs: px of the first view, standard
    deviation of the blur at aperture 1 and a distance of 1 from the focus. All (N,)."""

    first: np.ndarray
    second: np.ndarray
    u: np.ndarray
    v: np.ndarray
    mine: np.ndarray
    theirs: np.ndarray
    difference: np.ndarray
    deviation: np.ndarray

    def residual(self, aperture: np.ndarray, foci: np.ndarray) -> np.ndarray:
        """(N,) predicted less measured, in standard deviations. aperture, foci: (V,)."""
        mine = (aperture[self.first] * self.mine * (self.u - foci[self.first])) ** 2
        theirs = (aperture[self.second] * self.theirs * (self.v - foci[self.second])) ** 2
        return (mine - theirs - self.difference) / self.deviation

    def of(self, view: int) -> _Patches:
        """The patches of one view; those where it is the second, seen from there."""
        rows, turned = np.flatnonzero(self.first == view), np.flatnonzero(self.second == view)
        return _Patches(
            np.full(len(rows) + len(turned), view),
            np.concatenate([self.second[rows], self.first[turned]]),
            np.concatenate([self.u[rows], self.v[turned]]),
            np.concatenate([self.v[rows], self.u[turned]]),
            np.concatenate([self.mine[rows], self.theirs[turned]]),
            np.concatenate([self.theirs[rows], self.mine[turned]]),
            np.concatenate([self.difference[rows], -self.difference[turned]]),
            np.concatenate([self.deviation[rows], self.deviation[turned]]),
        )


def measure_lenses(
    pairs: BlurPairs,
    bounds: DisparityRange,
    ties: Ties,
    widths: np.ndarray,
    seed: int,
    foci: np.ndarray | None = None,
) -> MeasuredLenses | None:
    """The aperture that the views share, times their openings, or one each; and their foci. None for too few patches.

    bounds: of normalised disparity. ties: which views share an aperture, and openings; views that share nothing are
    tried with one aperture first. widths: (V,) px, of the images that the pairs were measured on. foci: (V,) normalised
    disparity to try first, such as EXIF's; by default those of the sharpest patches are.
    """
    if len(pairs) < FEWEST:
        return None
    pairs = pairs.thinned(MOST, seed)
    views, opening = len(widths), np.array(ties.opening)
    unit = 0.5 * COC_FRACTION * widths
    patches = _Patches(
        pairs.first, pairs.second,
        bounds.normalise(pairs.q_first), bounds.normalise(pairs.q_second),
        unit[pairs.first], pairs.zoom * unit[pairs.second],
        pairs.difference, pairs.deviation,
    )  # fmt: skip
    own = [patches.of(view) for view in range(views)]
    profile, starts = [], [np.full(views, 0.5), np.array([_sharpest(one) for one in own])]
    for start in starts if foci is None else [foci, *starts]:
        foci = start
        for aperture in APERTURES[::-1]:  # at a wide aperture foci are sharp, so they start those of the next
            foci = _swept(own, aperture * opening, foci, np.ones(1))[1]
            profile.append((float(_robust(patches.residual(aperture * opening, foci)).sum()), aperture, foci))
    _, aperture, foci = min(profile, key=lambda one: one[0])
    shared = _fitted(patches, own, np.zeros(views, int), aperture * opening, foci, seed)
    if len(set(ties.aperture)) == 1:
        return shared
    groups = np.array(ties.aperture)
    each = _fitted(patches, own, groups, *_swept(own, aperture * opening, foci, FACTORS), seed)
    # Half the aperture with the focus on the other side blurs much alike.
    sharp = (each.aperture_error <= DETERMINED) & (np.abs(each.foci - shared.foci) < TURNED)
    if np.mean(sharp) < SHARP:
        return shared
    logs = np.log(each.aperture / opening)
    middle = np.average(logs[sharp], weights=each.aperture_error[sharp] ** -2)
    apart = np.sum(((logs - middle) / each.aperture_error)[sharp] ** 2) / (sharp.sum() - 1)
    if apart <= APART:
        return shared
    # Where a view's own profile isn't sharp, the others' spread is all that is known of its aperture.
    aperture, error = np.where(sharp, each.aperture, np.exp(middle) * opening), float(np.median(each.aperture_error))
    return replace(
        each,
        aperture=aperture,
        low=float(np.median(aperture) * np.exp(-error)),
        high=float(np.median(aperture) * np.exp(error)),
        foci=np.where(sharp, each.foci, shared.foci),
        aperture_error=np.where(sharp, each.aperture_error, np.std(logs[sharp])),
        focus_error=np.where(sharp, each.focus_error, shared.focus_error),
        each=True,
    )


def _sharpest(patches: _Patches) -> float:
    """Normalised disparity at which a view is the sharper one, by the medians over BINS; 0.5 without patches."""
    if not len(patches.u):
        return 0.5
    order = np.array_split(np.argsort(patches.u, kind="stable"), min(BINS, len(patches.u)))
    medians = [np.median(patches.difference[part]) for part in order]
    return float(np.median(patches.u[order[int(np.argmin(medians))]]))


def _swept(
    own: list[_Patches], aperture: np.ndarray, foci: np.ndarray, factors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Apertures and foci (V,) of least robust cost on a grid, one view after the other. factors: on the aperture."""
    aperture, foci, first = aperture.copy(), foci.copy(), aperture
    for _ in range(SWEEPS):
        for view, patches in enumerate(own):
            if not len(patches.first):
                continue
            theirs = (aperture[patches.second] * patches.theirs * (patches.v - foci[patches.second])) ** 2
            wanted, costs = theirs + patches.difference, np.empty((len(factors), len(FOCI)))
            for row, factor in enumerate(factors):
                mine = (first[view] * factor * patches.mine * (patches.u - FOCI[:, None])) ** 2
                costs[row] = _robust((mine - wanted) / patches.deviation).sum(axis=1)
            least, column = np.unravel_index(int(np.argmin(costs)), costs.shape)
            aperture[view], foci[view] = first[view] * factors[least], FOCI[column]
    return aperture, foci


def _fitted(
    patches: _Patches, own: list[_Patches], groups: np.ndarray, aperture: np.ndarray, foci: np.ndarray, seed: int
) -> MeasuredLenses:
    """Refine all lenses together. groups: (V,) whose apertures are tied."""
    aperture, foci = _refined(patches, groups, aperture, foci)
    low, high = _interval(patches, aperture, foci, seed)
    few, floors = np.array([len(one.first) < FEWEST for one in own]), FLOORS if groups.max() == 0 else FLOORS_EACH
    aperture_error, focus_error = (
        np.where(few, np.inf, np.hypot(error, floor))
        for error, floor in zip(_errors(patches, groups, aperture, foci), floors, strict=True)
    )
    if groups.max() == 0:
        aperture_error = np.full(len(own), np.log(high / low) / 2)
    base, patch_count = float(np.median(aperture)), len(patches.first)
    return MeasuredLenses(aperture, foci, aperture_error, focus_error, False, base * low, base * high, patch_count)


def _interval(patches: _Patches, aperture: np.ndarray, foci: np.ndarray, seed: int) -> tuple[float, float]:
    """68 % interval of a factor on all apertures: of where its profile is least, over resamplings of the views."""
    views, random = len(foci), np.random.default_rng([seed, 2])
    none = np.full(views, -1)
    costs = []
    for factor in PROFILE:
        fixed, moved = _refined(patches, none, factor * aperture, foci)
        costs.append(_robust(patches.residual(fixed, moved)))
    best = []
    for _ in range(RESAMPLINGS):
        weight = np.bincount(random.integers(views, size=views), minlength=views).astype(float)
        best.append(_least(np.array(costs) @ (weight[patches.first] * weight[patches.second])))
    middle = np.median(best)
    below, above = WIDER * (np.quantile(best, [0.16, 0.84]) - middle) + middle
    # Factors that the patches can't tell apart at all, though each resampling prefers the same one.
    sums = np.sum(costs, axis=1)
    alike = np.log(PROFILE)[sums < sums.min() + ALIKE]
    below, above = min(below, alike[0]), max(above, alike[-1])
    return float(np.exp(-np.hypot(min(below, 0), FLOORS[0]))), float(np.exp(np.hypot(max(above, 0), FLOORS[0])))


def _least(costs: np.ndarray) -> float:
    """The logarithm of the factor of least cost, by a parabola through the profile's best three."""
    place, logs = int(np.argmin(costs)), np.log(PROFILE)
    if place in (0, len(logs) - 1):
        return float(logs[place])
    before, here, after = costs[place - 1 : place + 2]
    shift = 0.5 * (before - after) / max(before - 2 * here + after, 1e-12)
    return float(logs[place] + np.clip(shift, -0.5, 0.5) * (logs[1] - logs[0]))


def _errors(
    patches: _Patches, groups: np.ndarray, aperture: np.ndarray, foci: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(V,) standard deviations of the logarithm of the apertures, and of the foci: the sandwich formula, in which the
    patches of two photographs err together (Liang and Zeger, 1986)."""
    views, residual = len(foci), patches.residual(aperture, foci)
    slopes, trust = _slopes(patches, groups, aperture, foci), 1 / (1 + 0.5 * residual**2)
    normal = slopes.T @ (slopes * trust[:, None])
    pulls = np.zeros((views, slopes.shape[1]))
    np.add.at(pulls, patches.first, slopes * (trust * residual)[:, None])
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    deviation = WIDER * np.sqrt(np.diag(inverse @ (pulls.T @ pulls) @ inverse))
    return deviation[groups], deviation[-views:]


def _slopes(patches: _Patches, groups: np.ndarray, aperture: np.ndarray, foci: np.ndarray) -> np.ndarray:
    """(N, groups + V) derivatives of the residuals by the logarithms of the apertures and by the foci. A group of -1 is
    not derived by."""
    count, rows = int(groups.max()) + 1, np.arange(len(patches.first))
    mine, theirs = aperture[patches.first] * patches.mine, aperture[patches.second] * patches.theirs
    near, far = patches.u - foci[patches.first], patches.v - foci[patches.second]
    slopes = np.zeros((len(rows), count + len(foci)))
    if count:
        slopes[rows, groups[patches.first]] += 2 * (mine * near) ** 2
        slopes[rows, groups[patches.second]] -= 2 * (theirs * far) ** 2
    slopes[rows, count + patches.first] -= 2 * mine**2 * near
    slopes[rows, count + patches.second] += 2 * theirs**2 * far
    return slopes / patches.deviation[:, None]


def _refined(
    patches: _Patches, groups: np.ndarray, aperture: np.ndarray, foci: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton with the robust cost's weights, damped. groups: (V,) whose apertures are tied; -1 keeps them."""
    count, damping = int(groups.max()) + 1, 1e-2
    residual = patches.residual(aperture, foci)
    cost = float(_robust(residual).sum())
    for _ in range(STEPS):
        slopes, trust = _slopes(patches, groups, aperture, foci), 1 / (1 + 0.5 * residual**2)
        normal = slopes.T @ (slopes * trust[:, None])
        damped = normal + np.diag(damping * np.diag(normal) + 1e-6)
        step = -np.linalg.solve(damped, slopes.T @ (trust * residual))
        factor = np.exp(np.clip(step[:count], -0.5, 0.5))[groups] if count else 1.0
        tried = aperture * factor, foci + np.clip(step[count:], -0.2, 0.2)
        residual_tried = patches.residual(*tried)
        new = float(_robust(residual_tried).sum())
        if new >= cost:
            damping *= 10
            continue
        done = cost - new < 1e-4 * cost
        (aperture, foci), residual, cost, damping = tried, residual_tried, new, damping / 3
        if done:
            break
    return aperture, foci


def _robust(residual: np.ndarray) -> np.ndarray:
    return np.log1p(0.5 * residual**2)
