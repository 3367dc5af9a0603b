"""Plane-sweep stereo.

Sources: Collins, "A space-sweep approach to true multi-image matching", CVPR 1996, for the sweep over planes;
Hirschmueller, "Stereo processing by semiglobal matching and mutual information", TPAMI 2008, section 2.3, for paths.
"""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["stereo", "upsample", "semiglobal", "returns"]  # noqa: RUF022  # the op's name first, then in order of use

# Added to both variances, in squared encoded values, so that noise and rounding in flat patches don't correlate.
FLOOR = 2e-5
UNKNOWN = 0.0  # score of a pixel that no source sees, equal to that of two unrelated patches
CENTRE = 0.5  # subtracted from the images, since sums of squares around zero lose fewer digits
FAR = 2  # planes within this distance of the best one aren't alternatives to it


def stereo(
    reference: Tensor,
    sources: Tensor,
    maps: Tensor,
    disparities: Tensor,
    *,
    radius: int,
    best: int,
    backend: str = AUTO,
) -> Tensor:
    """How well each pixel matches the other views at each plane: (H, W, D), -1 ... 1. Not differentiable.

    reference: (H, W) and sources: (S, h, w), grey, encoded. maps: (S, 3, 4), any floating type; the first three columns
    times (x, y, 1) plus the last times disparity is the homogeneous image coordinate in the source. disparities: (D,),
    1 / scene unit. The score of a source is the normalised cross-correlation over a window of 2 radius + 1 pixels, a
    plane of constant depth; the score of a pixel is the mean of the `best` largest among the sources into which it
    projects (of all these sources if they are fewer), as the surface may be occluded in some. Outside an image its
    border pixels are repeated. Raises ValueError for other shapes.
    """
    if reference.ndim != 2 or sources.ndim != 3:
        found = f"{tuple(reference.shape)}, {tuple(sources.shape)}"
        raise ValueError(f"stereo: expected images (H, W) and (S, h, w), found {found}")
    if tuple(maps.shape) != (len(sources), 3, 4) or disparities.ndim != 1:
        found = f"{tuple(maps.shape)}, {tuple(disparities.shape)}"
        raise ValueError(f"stereo: expected maps ({len(sources)}, 3, 4) and disparities (D,), found {found}")
    if radius < 1 or not 1 <= best <= len(sources):
        raise ValueError(f"stereo: expected radius >= 1 and best in 1 ... {len(sources)}, found {radius}, {best}")
    found_in = implementation("stereo", backend, reference=reference, sources=sources)
    return found_in.stereo(reference.detach(), sources.detach(), maps.detach(), disparities.detach(), radius, best)


def upsample(scores: Tensor, coarse: Tensor, share: float, *, backend: str = AUTO) -> None:
    """Mix the enlarged scores of a coarser level (h, w, d) into scores (H, W, D), in place, with the weight `share`.

    Linear along all three axes. Pixels are areas, as in images; the first and the last plane are the same in both.
    """
    implementation("stereo", backend, scores=scores, coarse=coarse).upsample(scores, coarse.contiguous(), share)


def semiglobal(
    scores: Tensor, guide: Tensor, *, small: float, large: float, edge: float, backend: str = AUTO
) -> tuple[Tensor, Tensor, Tensor]:
    """The plane of each pixel by semiglobal matching along the four axes: (plane, score, margin), each (H, W).

    scores: (H, W, D); a plane's cost is its negative score. guide: (H, W), the grey image: a jump of more than one
    plane costs `large` / (1 + |difference of grey| / edge), but never less than `small`, the cost of a change by one
    plane. plane: fractional index, refined by a parabola through the summed costs. score: the pixel's own at the
    nearest whole plane. margin: how much more, in the mean over the paths, the best plane more than two planes away
    costs. Uses as much memory as the scores in addition to them.
    """
    found = implementation("stereo", backend, scores=scores, guide=guide)
    return found.semiglobal(scores.contiguous(), guide.detach().contiguous(), small, large, edge)


def returns(
    depth: Tensor, other: Tensor, there: Tensor, back: Tensor, *, pixels: float, share: float, backend: str = AUTO
) -> Tensor:
    """Where another view sees the same surface: (H, W) bool.

    depth: (H, W) and other: (h, w), z in scene units, 0 where unknown. there: (3, 4), the first three columns times
    (x, y, 1) times z plus the last is the homogeneous image coordinate in the other view, whose third component is z
    there; back: the same in the other direction; both are used in float64. A pixel is projected to the other view by
    its depth, and projected back with the depth of the pixel that it falls into. It must return to within `pixels` of
    its origin, with a relative difference of depth below `share`.
    """
    found = implementation("stereo", backend, depth=depth, other=other)
    return found.returns(depth.contiguous(), other.contiguous(), there.double(), back.double(), pixels, share)
