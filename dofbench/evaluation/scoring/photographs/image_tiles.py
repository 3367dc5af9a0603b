"""Two halves of an image like the squares of a checkerboard: a fit on one half is scored on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dofbench.core.similarity import centre, ssim_map, unmasked

TILES = 8  # number of tiles along the shorter side
SMALLEST = 16  # px, so that windows of SSIM fit into a tile
MARGIN = 1 / 8  # share of a tile's side: least distance of scored pixels from the other half


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of an image. half: (H, W), 0 or 1 by tile, starting with 0. inside: (H, W), scored pixels. side: of a
    tile, px. mask: (H, W), True for valid pixels, which are fitted and scored; None for all."""

    half: np.ndarray
    inside: np.ndarray
    side: int
    mask: np.ndarray | None = None

    @staticmethod
    def of(height: int, width: int, mask: np.ndarray | None = None) -> Tiles:
        """Tiles of an eighth of the shorter side, at least 16 px, cut off at the right and lower edge. Without valid
        pixels away from the tiles' borders, those at borders are scored."""
        side = max(SMALLEST, round(min(height, width) / TILES))
        margin = max(1, round(side * MARGIN))
        rows, columns = np.arange(height), np.arange(width)
        half = (rows[:, None] // side + columns[None, :] // side) % 2
        inside = _inner(rows, side, margin)[:, None] & _inner(columns, side, margin)
        if mask is not None:
            inside = inside & mask if (inside & mask).any() else mask
        return Tiles(half.astype(np.uint8), inside, side, mask)

    def fitted(self, half: int) -> np.ndarray:
        """(H, W) bool: the valid pixels of a half, on which a fit is made; those of both halves where it has none."""
        own = self.half == half
        if self.mask is None:
            return own
        return own & self.mask if (own & self.mask).any() else self.mask

    def scored(self, half: int) -> np.ndarray:
        """(H, W) bool: the pixels of that half that are scored."""
        return self.inside & (self.half == half)

    def shrunk(self, factor: int, half: int) -> np.ndarray:
        """(H // factor, W // factor) bool: the cells of factor x factor valid pixels within a half; without any, those
        with a pixel that is `fitted`, or else all."""
        share = _cells(self.fitted(half)[..., None].astype(np.float32), factor)[..., 0].mean(axis=(1, 3))
        if self.mask is None or (share == 1).any():
            return share == 1
        return share > 0 if (share > 0).any() else share >= 0


def shrink(image: np.ndarray, factor: int) -> np.ndarray:
    """Means over cells of factor x factor pixels, (H // factor, W // factor, 3); the rest is cut off."""
    return image if factor == 1 else _cells(image, factor).mean(axis=(1, 3))


def masked_psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR over the pixels of `mask` (H, W), dB, peak 1; infinite for equal images. ValueError for an empty mask."""
    if not mask.any():
        raise ValueError("masked PSNR: expected at least one pixel, found none")
    error = float(np.mean(np.square(prediction[mask].astype(np.float64) - truth[mask])))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def tiled_ssim(prediction: np.ndarray, truth: np.ndarray, tiles: Tiles) -> float:
    """Mean SSIM over the windows within one tile, centred on a valid pixel. Images and masks as for `ssim`."""
    similarity = ssim_map(*unmasked(prediction, truth, tiles.mask))
    reach = tiles.half.shape[0] - similarity.shape[0]  # size of a window minus one pixel
    first, last = slice(None, similarity.shape[0]), slice(reach, None)
    across = slice(None, similarity.shape[1]), slice(reach, None)
    rows = np.arange(tiles.half.shape[0]) // tiles.side
    columns = np.arange(tiles.half.shape[1]) // tiles.side
    whole = (rows[first] == rows[last])[:, None] & (columns[across[0]] == columns[across[1]])
    if tiles.mask is not None and (valid := whole & centre(tiles.mask, similarity)).any():
        whole = valid
    return float(similarity[whole].mean(dtype=np.float64))


def _inner(index: np.ndarray, side: int, margin: int) -> np.ndarray:
    """Which pixels of a line are at least `margin` from the borders between tiles, the image's ends excluded."""
    place, tile = index % side, index // side
    return ((place >= margin) | (tile == 0)) & ((place < side - margin) | (tile == tile[-1]))


def _cells(image: np.ndarray, factor: int) -> np.ndarray:
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
