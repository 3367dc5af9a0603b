"""The presets `paper` and `released`: a step's whole loss by formulae written out, and the table in
docs/published-presets.md, whose options must have the presets' values."""

from __future__ import annotations

import csv
import itertools
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import frontal
from small_scene import training_set
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE, FLOAT64_VALUE, LEARNED_STEP, LOSS_OF_A_STEP

from dofbench.core.lens import DisparityRange
from dofbench.methods.cards import find_method
from dofbench.optics.tone import TOE, decode, encode
from dofbench.runtime.ops import load
from dofbench.training.common.depth import SURFACE_ALPHA, sparse_depth
from dofbench.training.common.monitor import StageClock
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.surface_losses import distortion_loss, normal_consistency
from dofbench.training.gaussians.trainer import Trainer
from dofbench.training.gaussians.training_state import TrainingState
from dofbench.training.gaussians.training_step import take_step

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "published-presets.md"
PRESETS = ("paper", "released")


def preset(name: str, **changes) -> GaussianOptions:
    return GaussianOptions().with_overrides({**find_method("dofgaussian").preset(name)[1], **changes})


# ---- what a step's loss is ----


def step_function(x):
    """Eq. 10 after t steps, with the printed constants."""
    return 1 / (1 + np.exp(-15.0 * (x - 0.3)))


def scattered(light: np.ndarray, radius: np.ndarray, area: bool) -> np.ndarray:
    """Algorithm 1, pixel by pixel in float64; with the released code's area term if asked for."""
    height, width = radius.shape
    rows, columns = np.mgrid[:height, :width]
    total, weights = np.zeros_like(light), np.zeros(radius.shape)
    for i in range(height):
        for j in range(width):
            weight = 0.5 + 0.5 * np.tanh(4.0 * (radius[i, j] - np.hypot(rows - i, columns - j)))
            if area:
                weight /= radius[i, j] ** 2 + 0.2
            total += weight[..., None] * light[i, j]
            weights += weight
    return total / weights[..., None]


def expected_loss(name: str, state: TrainingState, view: ScaledView, progress: float, lens: tuple[float, float]):
    """The loss of a step at `progress`, after the adaptation has begun, by the equations and constants of the paper or
    of the released code."""
    paper, released = name == "paper", name == "released"
    camera, (aperture, focus) = view.camera, lens
    with torch.no_grad():
        raster = rasterise(state.gaussians, camera, state.options.appearance, sh_degree=3, geometry="distortion")
    depth, alpha = raster.depth.double().numpy(), raster.alpha.double().numpy()
    there = alpha > SURFACE_ALPHA
    disparity = np.where(there, 1 / np.where(there, depth, 1.0), 0.0)
    disparity[~there] = disparity[there].min()
    low, high = state.range.q_min, state.range.q_max
    if released:
        low, high = disparity[there].min(), np.quantile(disparity[there], 0.95)
    normalised = (disparity - low) / (high - low)
    if released:
        normalised = np.clip(normalised, 1e-5, 1.0)
    x = np.abs(normalised - focus)
    weight = step_function(x) if paper else 1 - step_function((x - x.min()) / (x.max() - x.min()))
    radius = 0.02 * camera.width * aperture * np.abs(normalised - focus)
    if paper:
        radius = radius * weight  # Eq. 11
    gamma = 2.2 if paper else 2.0
    light = decode(raster.color.double(), gamma, toe=TOE).numpy()
    image = encode(torch.from_numpy(scattered(light, radius, area=released)), gamma, toe=TOE)

    reference = load("ssim", "reference", function="l1_ssim")
    shares = torch.from_numpy(weight)
    loss = float(reference(image, view.image.double(), ssim_weight=0.2, weight=shares, weigh_all=paper))

    assert view.known is not None
    seen = there[view.known.rows, view.known.columns]
    rows, columns = view.known.rows[seen], view.known.columns[seen]
    difference = depth[rows, columns] - view.known.depth[seen].double().numpy()
    here = weight[rows, columns]
    known = np.sqrt((here * difference**2).mean()) if paper else (here * np.abs(difference)).mean()
    loss += 0.01 * (1 - 0.9 * progress) * known
    surface = (raster.normal, raster.alpha, raster.depth, raster.median_depth, camera)
    loss += 0.05 * float(normal_consistency(*surface, *((0.0, "splats") if paper else (0.6, "pixel"))))
    if released:
        loss += 100.0 * float(distortion_loss(raster.distortion, raster.alpha, view.image, 0.2, 100.0))
    return loss


@pytest.mark.parametrize("name", PRESETS)
def test_the_loss_of_a_step_is_the_published_one(name: str) -> None:
    """Eq. 13 over Eq. 5 to 7, 9 to 12, for the paper; its counterpart for the released code."""
    lens = 20.0, 0.4  # circles of up to six pixels
    options = preset(name, lens_init_aperture=lens[0], lens_init_focus=lens[1])
    scene = training_set()
    state = TrainingState(scene, options, 0)
    one = scene.views[0]
    known = sparse_depth(scene.points, one.camera, 0)
    view = ScaledView(0, one.name, one.camera, torch.from_numpy(one.image), known, None)
    expected = expected_loss(name, state, view, 0.7, (lens[0] + 1e-5, lens[1] + 1e-5))
    assert take_step(state, 1, 0.7, view, StageClock()) == pytest.approx(expected, rel=LOSS_OF_A_STEP)


def test_eq_5_of_a_learned_lens_in_the_paper_s_units() -> None:
    trainer = Trainer(training_set(), preset("paper", lens_init_aperture=0.8, lens_init_focus=0.3), 0)
    state, camera = trainer.state, trainer.views[0].camera
    view = ScaledView(0, "v0", camera, torch.zeros(4, 4, 3), None, None)
    raster = rasterise(trainer.gaussians, camera, state.options.appearance)
    shot = state.shot(view, SharpView(lambda: raster), state.adaptation(0.0))
    physical = trainer.lens_estimates()[trainer.views[0].name]
    aperture, focus = physical.aperture, physical.focus_depth
    assert aperture == pytest.approx(0.02 * camera.width * 0.80001 / state.range.extent, rel=FLOAT32_SCALAR)
    for depth in (3.0, 4.5, 6.0):
        found = abs(float(shot.radius(torch.tensor(1 / depth)).detach()))
        assert found == pytest.approx(aperture * abs(1 / focus - 1 / depth), abs=FLOAT32_VALUE)


def test_the_released_disparities_end_at_the_ends_of_their_range() -> None:
    bounds, disparity = DisparityRange(0.2, 0.6), torch.tensor([0.1, 0.2, 0.3, 0.6, 0.9], dtype=torch.float64)
    clipped, free = (Shot(frontal(100, 80, 90.0), bounds, 3.0, -1.2, None, clip) for clip in (True, False))
    normalised = np.array([1e-5, 1e-5, 0.25, 1.0, 1.0])
    assert clipped.radius(disparity).numpy() == pytest.approx(2 * (3.0 * normalised - 1.2), abs=FLOAT64_VALUE)
    assert clipped.circles(disparity).numpy() == pytest.approx(2 * abs(3.0 * normalised - 1.2), abs=FLOAT64_VALUE)
    assert clipped.out_of_focus(disparity).numpy() == pytest.approx(abs(normalised - 0.4), abs=FLOAT64_VALUE)
    assert free.radius(disparity).numpy() == pytest.approx(2 * (3.0 * (disparity.numpy() - 0.2) / 0.4 - 1.2))


@pytest.mark.parametrize("name", PRESETS)
def test_the_released_preset_alone_clips(name: str) -> None:
    state = TrainingState(training_set(), preset(name), 0)
    camera = state.cameras[0]
    view = ScaledView(0, "v0", camera, torch.zeros(4, 4, 3), None, None)
    raster = rasterise(state.gaussians, camera, state.options.appearance)
    clips = name == "released"
    assert state.shot(view, SharpView(lambda: raster), state.adaptation(0.0)).clipped is clips
    assert [shot.clipped for shot in state.shots()] == [clips] * 3


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(("progress", "of_means"), [(0.0, 1.6e-4), (0.5, 1.6e-5), (1.0, 1.6e-6)])
def test_parameters_move_at_the_published_rates(name: str, progress: float, of_means: float) -> None:
    """Adam's first step is the rate itself, whatever the gradient."""
    state = TrainingState(training_set(), preset(name), 0)
    extent = 1.1 * max(np.linalg.norm(c.centre - np.mean([c.centre for c in state.cameras], 0)) for c in state.cameras)
    rates = {
        "means": of_means * extent,
        "log_scales": 5e-3,
        "quaternions": 1e-3,
        "opacity_logits": 0.05,
        "sh_dc": 2.5e-3,
        "sh_rest": 1.25e-4,
    }
    before = {key: value.detach().clone() for key, value in state.gaussians.parameters.items()}
    for value in state.gaussians.parameters.values():
        value.grad = torch.ones_like(value)
    state.optimiser.step(progress, state.options.schedule.cooldown(progress))
    for key, rate in rates.items():
        moved = (before[key] - state.gaussians.parameters[key].detach()).double()
        largest = max(1.0, float(before[key].abs().max()))
        assert float((moved - rate).abs().max()) < LEARNED_STEP * largest, key


# ---- the table ----


def rows() -> list[tuple[str, list[str]]]:
    """(preset, options as `key=value`) of every row of the page's tables that has options."""
    found, name = [], ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            match = re.fullmatch(r"## Preset `(\w+)`", line)
            name = match[1] if match else ""
        elif name and line.startswith("|"):
            found.append((name, re.findall(r"`(\w+=[^`]+)`", line)))
    return found


def written(name: str) -> dict[str, object]:
    """The options that the card writes down for a preset."""
    card = tomllib.loads((ROOT / "methods" / "dofgaussian" / "method.toml").read_text())
    return card["presets"][name]


@pytest.mark.parametrize("name", PRESETS)
def test_the_presets_have_the_values_that_the_table_says(name: str) -> None:
    values, seen = preset(name).flat(), set()
    for option in (option for owner, options in rows() if owner == name for option in options):
        key, _, value = option.partition("=")
        assert key in values, option
        assert GaussianOptions().with_overrides({key: value}).flat()[key] == values[key], option
        seen.add(key)
    assert not set(written(name)) - seen, "options of the preset without a row"


# ---- the default against the paper ----

DEFAULT = ROOT / "docs" / "dofgaussian.md"
EFFECTS = ROOT / "reports" / "ablations" / "default-summary.csv"


def table_cells(heading: str) -> list[list[str]]:
    """The cells of the rows of the first table whose heading begins so."""
    lines = DEFAULT.read_text().splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith(heading)) + 2
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[start:])
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in rows]


def values_of(cell: str) -> dict[str, str]:
    return dict(pair.split("=") for pair in re.findall(r"`(\w+=[^`]+)`", cell))


def test_the_default_differs_from_the_paper_where_its_page_says() -> None:
    paper, released, short = (preset(name).flat() for name in ("paper", "released", "short"))
    changed = {name for name, value in short.items() if value != paper[name]}
    stated: set[str] = set()
    for _, printed, code, here, _, _ in table_cells("| setting"):
        cells = {"paper": printed, "released": printed if code == "as in the paper" else code, "short": here}
        for name, known in (("paper", paper), ("released", released), ("short", short)):
            found = values_of(cells[name])
            assert found.keys() == values_of(here).keys()
            options = GaussianOptions().with_overrides(found).flat()
            assert {one: options[one] for one in found} == {one: known[one] for one in found}
        stated |= values_of(here).keys()
    assert stated == changed


def test_the_effects_on_its_page_are_the_measured_ones() -> None:
    with EFFECTS.open(newline="") as file:
        measured = [row for row in csv.DictReader(file) if row["dataset"] == "mean"]
    differences = {(row["row"], row["column"]): row["difference"] for row in measured}
    cells = [row[-1] for row in (*table_cells("| setting"), *table_cells("| contribution"))]
    seen = set()
    for refocused, all_in_focus, row in re.findall(r"^(\S+) / (\S+), (.+)$", "\n".join(cells), re.MULTILINE):
        seen.add(row)
        for text, column in ((refocused, "psnr"), (all_in_focus, "aif_psnr")):
            value = differences[row, column]
            assert text.replace("−", "-") == (f"{float(value):+.2f}" if value else "no")
    assert len(seen) == len(cells) - 2
