"""Log ratios of band energies: closed forms, what they tolerate, and a lens that PSNR of a shifted picture misses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from blurred_tabletop import lens
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve
from tolerances import FLOAT64_VALUE

from dofbench.core.content import content_folder
from dofbench.evaluation.scoring.photograph_scores import picture_blur
from dofbench.evaluation.scoring.photographs import band_energies
from dofbench.evaluation.scoring.photographs.band_energies import BANDS, FLOOR, WINDOW, band_ratios
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr
from dofbench.evaluation.scoring.photographs.predict import recoloured_by
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import load_scene

SIZE = 200
TILES = Tiles.of(SIZE, SIZE)
DB = 10 / math.log(10)


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 3, axis=2)


def noise(sigma: float = 0.7, size: int = SIZE, margin: int = 0) -> np.ndarray:
    """Blurred white noise about mid-grey."""
    texture = gaussian_filter(np.random.default_rng(0).normal(size=(size + margin, size + margin)), sigma)
    return grey(0.5 + 0.1 * texture / texture.std())


def error(prediction: np.ndarray, photograph: np.ndarray, tiles: Tiles = TILES) -> float:
    return float(band_ratios(prediction, photograph, tiles).errors.mean())


def test_a_photograph_is_as_blurred_as_itself() -> None:
    found = band_ratios(noise(), noise(), TILES)
    assert np.array_equal(found.errors, np.zeros(len(BANDS))) and found.ratios.shape[1] == TILES.scored.sum()


@pytest.mark.parametrize(("omega", "blur"), [(0.4, 2.0), (1.1, 0.8), (1.1, -0.5)])
def test_a_wave_loses_what_a_gaussian_takes(omega: float, blur: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A Gaussian of this sigma leaves exp(-(sigma omega)^2) of a wave's energy, in every band. Negative: the
    photograph is the more blurred one."""
    monkeypatch.setattr(band_energies, "FLOOR", 1e-9)
    amplitude = 1e-3
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    wave = np.sin(omega * (0.8 * x + 0.6 * y))
    sharp, blurred = (grey(0.5 + amplitude * a * wave) for a in (1.0, math.exp(-0.5 * (blur * omega) ** 2)))
    found = band_ratios(*((blurred, sharp) if blur > 0 else (sharp, blurred)), TILES)
    means = 2 * DB * math.log((0.5 + amplitude) / (0.5 - amplitude))  # by which local means may differ, dB
    expected = -math.copysign((blur * omega) ** 2 * DB, blur)
    assert found.excess == pytest.approx(np.full(len(BANDS), expected), abs=means)
    assert found.errors == pytest.approx(np.abs(found.excess), abs=means)


def by_chance(shift: int) -> float:
    """Root mean square over bands of what a shift along x changes of the log energies of white noise, dB.

    The energy's change is that of its window D, of variance 2 D * rho^2 * D, rho being the band's autocorrelation.
    """
    rows, columns = np.nonzero(TILES.scored)
    squares = []
    for band in BANDS:
        impulse = np.zeros((101, 101))
        impulse[50, 50] = 1
        kernel = gaussian_filter(impulse, band) - gaussian_filter(impulse, 2 * band)
        correlation = fftconvolve(kernel, kernel, mode="same")
        correlation = (correlation / correlation.max()) ** 2
        for at in range(len(rows) // 26, len(rows), len(rows) // 13):
            one = np.zeros((SIZE, SIZE))
            one[rows[at], columns[at]] = 1
            window = gaussian_filter(one, WINDOW * TILES.side) * TILES.scored
            window /= window.sum()
            change = window - np.roll(window, shift, axis=1)
            squares.append(2 * np.sum(change * fftconvolve(change, correlation, mode="same")))
    return DB * math.sqrt(np.mean(squares))


@pytest.mark.parametrize("gain", [0.8, 1.25])
@pytest.mark.parametrize("shift", [1, 2])
def test_a_shift_and_an_exposure_change_little(shift: int, gain: float) -> None:
    large = noise(0.0, margin=2)
    photograph, shifted = large[:SIZE, :SIZE], large[:SIZE, shift : SIZE + shift]
    exposed = 2 * DB * abs(math.log((0.5 + FLOOR) / (0.5 + FLOOR / gain)))  # of the floor of means at mid-grey, dB
    assert error(gain * photograph, photograph) < 1.1 * exposed
    assert 0.1 * by_chance(shift) < error(gain * shifted, photograph) < by_chance(shift) + exposed < 1.5
    # The same shift leaves PSNR nothing to tell by.
    blurred = np.stack([gaussian_filter(photograph[..., 0], 3.0)] * 3, axis=2)
    assert masked_psnr(shifted, photograph, TILES.scored) < masked_psnr(blurred, photograph, TILES.scored)
    assert error(blurred, photograph) > 4 * error(gain * shifted, photograph)


def test_the_error_grows_with_the_difference_of_blurs() -> None:
    texture = noise(0.3)[..., 0]
    photograph = grey(gaussian_filter(texture, 1.2))
    found = [band_ratios(grey(gaussian_filter(texture, s)), photograph, TILES) for s in (0, 0.6, 1.2, 1.8, 2.4, 3.0)]
    errors = [float(one.errors.mean()) for one in found]
    excess = [float(one.excess.mean()) for one in found]
    assert errors[0] > errors[1] > errors[2] == 0 < errors[3] < errors[4] < errors[5]
    assert excess == sorted(excess, reverse=True) and excess[0] > 0 > excess[-1]


def test_rounding_to_8_bits_is_below_the_floor() -> None:
    """Rounding has a tenth of the floor's standard deviation, so where there is no texture it adds 1 % to it."""
    smooth = grey(0.4 + 0.2 * np.linspace(0, 1, SIZE)[None] * np.ones((SIZE, 1)))
    textured = smooth + grey(3 * FLOOR * np.random.default_rng(1).normal(size=(SIZE, SIZE)))
    found = band_ratios(np.round(textured * 255) / 255, textured, TILES)
    assert 0 < found.errors.mean() < DB * math.log(1.01)


def test_without_texture_there_is_no_error() -> None:
    flat = np.full((SIZE, SIZE, 3), 0.4)
    found = band_ratios(noise(), flat, TILES)
    assert found.ratios.shape == (len(BANDS), 0) and np.isnan(found.errors).all() and np.isnan(found.excess).all()


def test_a_masked_pixel_has_no_influence() -> None:
    mask = np.ones((SIZE, SIZE), bool)
    mask[40:110, 60:150] = False
    tiles = Tiles.of(SIZE, SIZE, mask)
    one, two = noise(1.0), noise(0.7)
    damaged = [np.where(mask[..., None], image, value) for image, value in ((one, 0.0), (two, 1.0))]
    assert error(*damaged, tiles) == pytest.approx(error(one, two, tiles), abs=FLOAT64_VALUE)
    assert error(one, two, tiles) != error(one, two)


def test_a_lens_is_told_where_psnr_of_a_shifted_picture_prefers_another() -> None:
    """The built-in scene through two lenses: each is predicted best by its own, though 2 px beside."""
    view = load_scene(content_folder("datasets") / "tabletop", width=192).views[0]
    sharp, depth, size = view.image().astype(np.float32), view.depth(), (view.camera.height, view.camera.width)
    pictures = {aperture: defocus_numpy(sharp, depth, lens(aperture, 0.5, 192))[0] for aperture in (0.5, 1.0, 2.0)}
    tiles = Tiles.of(*size)
    for own in (0.5, 1.0):
        shifted = {aperture: np.roll(picture, 2, axis=1) for aperture, picture in pictures.items()}
        errors = {aperture: error(picture, pictures[own], tiles) for aperture, picture in shifted.items()}
        psnr = {aperture: masked_psnr(picture, pictures[own], tiles.scored) for aperture, picture in shifted.items()}
        assert min(errors, key=errors.__getitem__) == own and max(psnr, key=psnr.__getitem__) == 2.0


def test_displaced_texture_is_not_taken_for_blurred() -> None:
    """The protocol's fit of colours lowers its contrast in all bands alike, here by more than 5 dB."""
    photograph = noise(1.0)
    picture = recoloured_by(np.roll(photograph, 2, axis=1).astype(np.float32), photograph, TILES)
    assert band_ratios(picture.astype(np.float64), photograph, TILES).excess.mean() < -5
    assert abs(picture_blur(picture, photograph, TILES)["photo_blur_bias"]) < 2
