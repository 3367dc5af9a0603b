"""Option groups: valid and refused values, and the listing of options."""

from dataclasses import dataclass, replace

import pytest

from dofbench.core.errors import InputError
from dofbench.methods.cards import find_method
from dofbench.training.common.losses import AdaptationOptions
from dofbench.training.common.options import OptionGroups, listed_options
from dofbench.training.gaussians.gaussian_options import GaussianOptions, ScheduleOptions


def test_strings_become_the_options_type():
    options = GaussianOptions.of(steps="120", lens="false", lens_lr="1e-3", depth_norm="l1")
    found = (options.schedule.steps, options.lens.lens, options.lens.lens_lr, options.supervision.depth_norm)
    assert found == (120, False, 1e-3, "l1")


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("stepz", 1, "did you mean steps"),
        ("steps", "many", "a number"),
        ("steps", "1.5", "a number"),
        ("steps", 1.5, "whole"),
        ("lens", "maybe", "true or false"),
        ("depth_norm", "l3", "one of l1, l2"),
        ("lens_blades", 2, "at least 3"),
        ("lens_rings", -1, "at least 0"),
        ("lens_init_aperture", 0, "more than 0"),
        ("held_back", 1.0, "below 1"),
        ("depth_prior_coarser", -1, "at least 0"),
        ("lens_trials", "lens,colour", "some of lens, share, model"),
    ],
)
def test_a_bad_override_is_one_clear_line(name, value, part):
    with pytest.raises(InputError, match=part) as caught:
        GaussianOptions.of(**{name: value})
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_an_unknown_name_is_told_all_that_there_are():
    with pytest.raises(InputError) as caught:
        GaussianOptions().with_overrides({"lens.activation": "ends"}, "FILE: rendering")
    assert str(caught.value).startswith("FILE: rendering: found 'lens.activation'")
    assert all(name in str(caught.value) for name in GaussianOptions().flat())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"lens_model": "samples", "lens_blades": 6}, "0: a disc"),
        ({"lens_range": "render", "lens_per": "aperture"}, "view or scene"),
        ({"reset_filtered": True, "filter_3d": False}, "there is no filter"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes, expected):
    with pytest.raises(InputError, match=expected):
        GaussianOptions.of(**changes)


def test_a_copy_leaves_the_original_and_its_other_groups_alone():
    first = GaussianOptions.of(steps=5)
    second = first.with_overrides({"lens_lr": 1.0})
    assert first.lens.lens_lr != second.lens.lens_lr == 1.0
    assert second.schedule is first.schedule and second.flat() == {**first.flat(), "lens_lr": 1.0}


def test_every_option_says_what_it_means_in_which_unit_and_where_it_comes_from():
    listed = {option.name: option for option in listed_options(GaussianOptions)}
    assert {name: option.default for name, option in listed.items()} == GaussianOptions().flat()
    for option in listed.values():
        assert option.meaning.endswith((".", ")")) and option.source and "Unit" not in option.meaning, option
    rate = listed["lens_from"]
    assert (rate.group, rate.type, rate.unit, rate.source) == (
        "lens",
        "number",
        "share of the training",
        "released code",
    )
    assert listed["depth_norm"].type == "l1, l2" and listed["steps"].type == "whole number"
    assert listed["lens"].type == "true or false" and listed["depth_prior_file"].type == "text"


@dataclass(frozen=True)
class Undocumented:
    """A group of two options."""

    first: int = 1
    """A number. Unit: none. Source: own."""
    second: int = 2
    """A number whose unit nobody knows."""


@dataclass(frozen=True)
class Unlisted(OptionGroups):
    """Options that can't be listed."""

    group: Undocumented = Undocumented()


@dataclass(frozen=True)
class Twice(OptionGroups):
    """Two groups with options of one name."""

    group: AdaptationOptions = AdaptationOptions()
    again: AdaptationOptions = AdaptationOptions()


def test_an_option_without_unit_or_source_is_found():
    with pytest.raises(ValueError, match="option second of group"):
        listed_options(Unlisted)


def test_a_name_is_one_option():
    with pytest.raises(TypeError, match="adaptation: in the groups group and again"):
        Twice.of()


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_a_method_lists_what_its_user_may_set(name):
    made = find_method(name).create({}, 0, "cpu")
    listed = {option.name for option in made.available_options()}
    assert listed | set(made.FORCED) == GaussianOptions().flat().keys() and not listed & set(made.FORCED)


def test_rates_cool_down_at_the_end_only():
    schedule = ScheduleOptions(cooldown_from=0.8, cooldown_to=0.1)
    assert [schedule.cooldown(p) for p in (0.0, 0.8, 0.9, 1.0)] == pytest.approx([1, 1, 0.55, 0.1])
    assert ScheduleOptions().cooldown(1.0) == 1.0


def test_photographs_are_shrunk_at_the_beginning_only():
    schedule = ScheduleOptions(coarse_until=0.2, coarse_factor=4)
    assert [schedule.size(progress) for progress in (0.0, 0.19, 0.2, 1.0)] == [4, 4, 1, 1]
    assert sorted(schedule.sizes) == [1, 4] and ScheduleOptions().sizes == (1,)
    assert replace(schedule, coarse_factor=1).sizes == (1,)
