"""The catalogue is complete, and some cheap cases of each group meet their bounds as in the published table."""

from __future__ import annotations

from collections import Counter

import pytest

from dofbench.evaluation.stability.case import Setting, kernel_settings
from dofbench.evaluation.stability.catalogue import catalogue, chosen, limit_of, read_limits
from dofbench.evaluation.stability.measure import measured
from dofbench.evaluation.stability.stability_options import GROUPS, Stability
from dofbench.runtime.ops import ops

CASES = {case.id: case for case in catalogue()}
CHEAP = """
    lens/focus-beyond-far lens/aperture-0 lens/depth-nan lens/radius-nan lens/aperture-1e30 lens/no-gaussians
    lens/range-degenerate lens/surface-one-nan lens/circle-range-1e-06 lens/known-depth-crowded-squared
    light/highlight-1e6 light/black-gradient-gamma-4 light/round-trip-gamma-2.2 light/nan-8-bit light/mix-1000
    light/mix-nan light/colours-nan light/colours-changed-by-1e+06 invariants/constant invariants/order
    invariants/tiles invariants/stereo-shift gaussians/quaternion-length-1e-30 gaussians/needle-1e4 gaussians/none
    gaussians/half-a-pixel gaussians/nan-means fields/ordinary fields/opaque-1e+30 fields/nan-in-the-grid
    fields/rays-beside fields/rays-grazing fields/near-plane images/scatter-1x1 images/rasterize-1x9 images/ssim-1x1
    images/stereo-1x1 files/exr-half files/alpha-8-bit datasets/1x1 datasets/noisy-black
    training/dofgaussian-planted-nan-lens training/dofgaussian-planted-nan-means
    training/mipsplatting-photograph-nan training/nerf-around training/mipsplatting-vanished-faded
    gradients/raster-alpha-above-threshold gradients/ssim-close
""".split()


def test_there_are_at_least_eighty_cases_of_every_group_with_names_of_their_own():
    assert len(CASES) >= 80
    assert {case.group for case in CASES.values()} == set(GROUPS)
    assert not [name for name, count in Counter(case.id for case in catalogue()).items() if count > 1]


def test_every_case_says_what_must_hold_where_and_where_its_bound_comes_from():
    for case in CASES.values():
        assert case.holds and case.bound and case.settings, case.id
        places = [(setting.label, setting.precision) for setting in case.settings]
        assert len(set(places)) == len(places), case.id


@pytest.mark.parametrize("op", ops())
def test_every_kernel_is_under_test_in_every_backend_and_precision(op):
    places = {setting for case in CASES.values() if case.subject == op for setting in case.settings}
    assert places >= {Setting("reference", "float64"), Setting("reference", "float32")}
    assert places == set(kernel_settings(op))


@pytest.mark.parametrize("name", CHEAP)
def test_a_case_is_met_but_for_known_limits(name):
    case, limits = CASES[name], read_limits()
    for setting in case.settings:
        found = measured(case, setting)
        assert found.met or limit_of(case, setting, limits), f"{setting}: {found}"


def test_a_kernel_and_a_group_narrow_the_cases():
    left = chosen(Stability(kernel="ssim", group=("invariants", "images")))
    assert {case.subject for case in left} == {"ssim"}
    assert {case.group for case in left} == {"invariants", "images"}


def test_a_method_narrows_to_its_training():
    left = chosen(Stability(method="mipsplatting"))
    assert {(case.group, case.subject) for case in left} == {("training", "mipsplatting")}
    assert not [case.id for case in left if "lens" in case.name]
