"""The shipped methods through the contract that the harness uses."""

from dataclasses import replace

import numpy as np
import pytest
from made_up import Recorder
from small_scene import noise
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens
from dofbench.methods.cards import find_method
from dofbench.running.ablation_tables import TUNING, read_tables, tables_of
from dofbench.scenes.ply import read_vertices
from dofbench.training.gaussians.gaussian_method import RENDERING, GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.splats import read_offset

CAMERA = noise().views[0].camera
LENS = PhysicalLens(aperture=8.0, focus_disparity=0.2, width=40)


@pytest.fixture(scope="module")
def training_set():
    return noise()


GAUSSIAN = sorted(
    file.parent.name
    for file in content_folder("methods").glob("*/method.toml")
    if issubclass(find_method(file.parent.name).method_class(), GaussianMethod)
)


def _trained(name, training_set, **options):
    entry = find_method(name)
    method = entry.create({**entry.card.presets["smoke"], "steps": 6, **options}, 0, "cpu")
    method.fit(training_set, Budget(steps=6), Recorder())
    return entry, method


@pytest.mark.parametrize("filter_3d", [True, False])
@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_a_saved_method_renders_the_same_with_its_own_settings(name, filter_3d, training_set, tmp_path):
    settings = {"filter_2d": 0.3, "filter_3d": filter_3d, "background": 0.2, "lens_gamma": 2.0}
    entry, method = _trained(name, training_set, **settings)
    method.save(tmp_path)
    # This method is made without these settings; they are read from the file.
    again = entry.create({}, 0, "cpu")
    again.load(tmp_path)
    for lens in (None, LENS) if entry.card.capabilities.refocus else (None,):
        before, after = method.render(CAMERA, lens), again.render(CAMERA, lens)
        assert np.abs(before.image - after.image).max() < FLOAT32_VALUE
        assert np.abs(before.depth / after.depth - 1).max() < FLOAT32_VALUE
    assert again.lens_estimates() == method.lens_estimates()
    assert again.describe() == method.describe()


def test_a_scene_nearer_than_the_usual_near_plane_is_saved_with_its_own(training_set, tmp_path):
    """Surfaces between 3 / 64 and 6 / 64 of a unit from the first camera; 3DGS draws nothing there."""
    points = replace(training_set.points, xyz=training_set.points.xyz / 64)
    entry, method = _trained("mipsplatting", replace(training_set, points=points))
    method.save(tmp_path)
    before, after = method.render(CAMERA, None), _loaded(entry, tmp_path).render(CAMERA, None)
    assert before.image.mean() > 0.1
    assert np.abs(before.image - after.image).max() < FLOAT32_VALUE


def test_a_georeferenced_model_has_the_files_coordinates(training_set, tmp_path):
    offset = (448260.0, 5411932.0, 136.0)
    entry, near = _trained("mipsplatting", training_set)
    _, far = _trained("mipsplatting", replace(training_set, offset=offset))
    near.save(tmp_path / "near")
    far.save(tmp_path / "far")
    again = _loaded(entry, tmp_path / "far")
    # The same training, rendered by the same local cameras; the file alone is elsewhere.
    assert np.array_equal(near.render(CAMERA, None).image, far.render(CAMERA, None).image)
    assert np.abs(far.render(CAMERA, None).image - again.render(CAMERA, None).image).max() < FLOAT32_VALUE
    places = [
        np.stack([vertices[axis] for axis in "xyz"], 1).astype(np.float64)
        for vertices in (read_vertices(tmp_path / name / "gaussians.ply", "a model") for name in ("near", "far"))
    ]
    assert np.array_equal(places[0] + np.array(offset), places[1])
    again.save(tmp_path / "again")
    assert read_offset(tmp_path / "again" / "gaussians.ply") == offset


@pytest.mark.parametrize("name", ["dofgaussian", "mipsplatting"])
def test_colours_of_the_photographs_are_kept_and_aren_t_the_scene_s(name, training_set, tmp_path):
    entry, method = _trained(name, training_set, colour_per_view="affine")
    method.save(tmp_path / "a")
    again = _loaded(entry, tmp_path / "a")
    colours, kept = method.colour_estimates(), again.colour_estimates()
    assert list(kept) == ["a", "b"] and all(np.array_equal(kept[view], colours[view]) for view in kept)
    assert np.abs(colours["a"] - np.eye(3, 4)).max() > 1e-3
    assert np.abs(again.render(CAMERA, None).image - method.render(CAMERA, None).image).max() < FLOAT32_VALUE
    _, plain = _trained(name, training_set)
    plain.save(tmp_path / "b")
    assert plain.colour_estimates() is None and not (tmp_path / "b" / "colours.json").exists()
    again.load(tmp_path / "b")
    assert again.colour_estimates() is None


def test_what_is_loaded_and_saved_again_says_the_same(training_set, tmp_path):
    entry, method = _trained("dofgaussian", training_set)
    method.save(tmp_path / "a")
    again = entry.create({}, 0, "cpu")
    again.load(tmp_path / "a")
    again.save(tmp_path / "b")
    assert (tmp_path / "a" / "lenses.json").read_bytes() == (tmp_path / "b" / "lenses.json").read_bytes()
    assert np.array_equal(again.render(CAMERA, LENS).image, _loaded(entry, tmp_path / "b").render(CAMERA, LENS).image)


@pytest.mark.parametrize("model", ["scatter", "samples"])
def test_every_option_that_rendering_looks_at_is_kept_in_the_file(training_set, model):
    _entry, method = _trained("dofgaussian", training_set)
    used = set()

    def watched(group):
        class Watched(type(group)):
            def __getattribute__(self, name):
                used.add(name)
                return super().__getattribute__(name)

        return Watched(**vars(group))

    options = GaussianOptions.of(lens_model=model)
    method._trainer = method._renderer = None
    method._options = replace(options, **{name: watched(group) for name, group in vars(options).items()})
    used.clear()  # that they fit together is looked at when they are made
    method.render(CAMERA, None)
    method.render(CAMERA, LENS)
    # Not stored: filter_3d is merged into the Gaussians, and blur_to_depth only concerns gradients.
    elsewhere = {"filter_3d", "blur_to_depth"}
    assert used & GaussianOptions().flat().keys() <= {*RENDERING, *elsewhere}
    assert {"lens_gamma", "filter_2d"} <= used


def _loaded(entry, folder):
    method = entry.create({}, 0, "cpu")
    method.load(folder)
    return method


@pytest.mark.parametrize(
    ("file", "change", "found"),
    [
        ("gaussians.ply", None, "no such file"),
        ("gaussians.ply", lambda data: data[:-3], "bytes of vertices"),
        ("lenses.json", None, "no such file"),
        ("lenses.json", lambda data: data[:-5], "no JSON"),
        ("lenses.json", lambda data: data.replace(b'"version": 1', b'"version": 2'), "version: "),
        ("lenses.json", lambda data: data.replace(b'"aperture"', b'"opening"', 3), "views.a"),
        ("lenses.json", lambda data: data.replace(b'"sh_degree"', b'"degree"'), "rendering.degree"),
        ("lenses.json", lambda data: data.replace(b'"filter_2d": 0.1', b'"filter_2d": "wide"'), "wide"),
        ("lenses.json", lambda data: data.replace(b'"near": 0.2', b'"near": -0.2'), "rendering.near: -0.2"),
        ("lenses.json", lambda data: data.replace(b'"near": 0.2', b'"near": "here"'), "rendering.near: here"),
    ],
)
def test_a_damaged_model_is_named(training_set, tmp_path, file, change, found):
    entry, method = _trained("dofgaussian", training_set)
    method.save(tmp_path)
    path = tmp_path / file
    if change is None:
        path.unlink()
    else:
        damaged = change(path.read_bytes())
        assert damaged != path.read_bytes()
        path.write_bytes(damaged)
    with pytest.raises(InputError, match=found) as caught:
        _loaded(entry, tmp_path)
    assert file in str(caught.value) and "\n" not in str(caught.value)


def test_what_a_method_fixes_can_not_be_set():
    entry = find_method("mipsplatting")
    with pytest.raises(InputError, match="this method fixes it"):
        entry.create({"lens": True}, 0, "cpu")


@pytest.mark.parametrize("name", GAUSSIAN)
def test_every_preset_names_known_options(name):
    entry = find_method(name)
    for preset in entry.card.presets:
        entry.create(entry.preset(preset)[1], 0, "cpu")


def test_the_baseline_is_trained_as_well_as_our_method():
    ours, theirs = (find_method(name).preset("cpu")[1] for name in ("lensselect", "mipsplatting"))
    of_a_lens = {key for key in ours if key.startswith(("lens_", "blur_")) or key == "adaptation"}
    assert theirs.keys() == ours.keys() - of_a_lens
    tuning = next(table for table in read_tables(tables_of("mipsplatting")).tables if table.id == TUNING)
    apart = {key for key, value in theirs.items() if value != ours[key]}
    assert apart <= {"depth_weight", "densify_until"}
    for key in apart:  # the baseline's own tuning tried the method's value
        assert any(row.set == {key: ours[key]} for row in tuning.rows), key


# What the trainer shares on both boards.
SHARED = """steps coarse_until coarse_factor cooldown_from cooldown_to sh_degree sh_every edge_weight ssim_weight
    colour_per_view start_points start_behind near_share means_lr means_lr_final sh_dc_lr sh_rest_lr opacity_lr scale_lr
    rotation_lr
    grow_gradient grow_absolute reset_every max_gaussians""".split()
# The trainer's too, on the shared board: there depth is supervised in every method, in most by its own tuned weight.
SHARED_DEPTH = "depth_prior depth_space depth_norm depth_decay".split()


# What the authors' loss has otherwise (docs/baselines.md).
OF_AUTHORS = {"cocogaussian": {"ssim_weight": 0.25}}


@pytest.mark.parametrize("name", [name for name in GAUSSIAN if name != "lensselect"])
def test_as_published_nothing_is_shared_that_a_paper_has_not(name):
    options = GaussianOptions()
    base, theirs = (options.with_overrides(shared_of(one, "short")).flat() for one in ("mipsplatting", name))
    own = OF_AUTHORS.get(name, {})
    assert {key: theirs[key] for key in SHARED} == {key: base[key] for key in SHARED} | own
    published = {"edge_weight": 0.0, "start_points": 0, "start_behind": 0.0, "colour_per_view": "off"}
    published |= {"ssim_weight": 0.2} | own
    assert {key: theirs[key] for key in published} == published
    assert (theirs["depth_weight"] > 0) is (name == "dofgaussian")  # whose contribution it is


@pytest.mark.parametrize("preset", ["cpu", "cpu-v2"])
@pytest.mark.parametrize("name", GAUSSIAN)
def test_what_is_shared_is_shared_by_all(name, preset):
    options = GaussianOptions()
    base, theirs = (options.with_overrides(shared_of(one, preset)).flat() for one in ("mipsplatting", name))
    assert (theirs["start_behind"] > 0) is (preset == "cpu-v2")
    assert {key: theirs[key] for key in SHARED + SHARED_DEPTH} == {key: base[key] for key in SHARED + SHARED_DEPTH}
    assert theirs["depth_weight"] > 0 and theirs["start_points"] > 0 and theirs["edge_weight"] > 0


def shared_of(name, preset):
    """The preset's options that the trainer has; a method's own are left aside."""
    known = GaussianOptions().flat()
    return {key: value for key, value in find_method(name).preset(preset)[1].items() if key in known}
