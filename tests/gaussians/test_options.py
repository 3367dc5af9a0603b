import pytest

from dofbench.core.errors import InputError
from dofbench.learning.options import TrainerOptions
from dofbench.running.method_cards import find_method


def test_strings_become_the_options_type():
    options = TrainerOptions().with_overrides({"steps": "120", "lens": "false", "lens_lr": "1e-3", "depth_norm": "l1"})
    assert (options.steps, options.lens, options.lens_lr, options.depth_norm) == (120, False, 1e-3, "l1")


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("stepz", 1, "unknown name"),
        ("steps", "many", "a number"),
        ("steps", "1.5", "a number"),
        ("steps", 1.5, "whole"),
        ("lens", "maybe", "true or false"),
        ("depth_norm", "l3", "one of l1, l2"),
        ("lens_blades", 2, "at least 3"),
        ("lens_rings", -1, "at least 0"),
        ("lens_init_aperture", 0, "more than 0"),
    ],
)
def test_a_bad_override_is_one_clear_line(name, value, part):
    with pytest.raises(InputError, match=part) as caught:
        TrainerOptions().with_overrides({name: value})
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_points_of_the_lens_make_a_disc_only():
    with pytest.raises(InputError, match="0: a disc"):
        TrainerOptions().with_overrides({"lens_model": "samples", "lens_blades": 6})


def test_every_option_is_documented():
    text = TrainerOptions.__doc__
    undocumented = [
        name
        for name in TrainerOptions.__dataclass_fields__
        if name not in text
        and not name.endswith(("_lr", "_lr_final"))
        and name not in ("lens_init_aperture", "lens_init_focus")
    ]
    assert not undocumented


def test_rates_cool_down_at_the_end_only():
    options = TrainerOptions(cooldown_from=0.8, cooldown_to=0.1)
    assert [options.cooldown(p) for p in (0.0, 0.8, 0.9, 1.0)] == pytest.approx([1, 1, 0.55, 0.1])
    assert TrainerOptions().cooldown(1.0) == 1.0


@pytest.mark.parametrize("preset", ["paper", "released"])
def test_depth_supervision_falls_to_a_tenth_as_published(preset):
    entry = find_method("dofgaussian")
    options = TrainerOptions().with_overrides(entry.preset(preset)[1])
    for step in (0, 10_000, 30_000):
        assert options.depth_factor(step / 30_000) == pytest.approx(0.01 * (1 - 0.9 * step / 30_000))
    # The paper writes a norm, the released code takes absolute differences; both of depth itself.
    assert (options.depth_norm, options.depth_space) == ({"paper": "l2", "released": "l1"}[preset], "depth")


def test_the_released_preset_has_the_released_geometry_losses():
    options = TrainerOptions().with_overrides(find_method("dofgaussian").preset("released")[1])
    assert (options.normal_weight, options.normal_from, options.normal_median) == (0.05, 0.5, 0.6)
    assert (options.distortion_weight, options.distortion_from) == (100.0, 0.5)
    assert (options.distortion_near, options.distortion_far, options.normal_form) == (0.2, 100.0, "pixel")
