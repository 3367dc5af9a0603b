"""What the model's page says of the design, each sentence from the rows of its tables, and what is weakest in it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from gpu_model_tables import Row, of
from gpu_scatter_windows import BAND
from gpu_sizes import Sizes
from gpu_times import Time

AUTO_REACH = 24  # pixels: from where on tiles have the scatter's linear form, kernels/scatter/gpu.py

WEAKEST = (
    "Intersections for each Gaussian, see above: most kernels' times go with them.",
    "Caches: L1 and L2 have no bandwidth of their own here, and what is read again is taken to be there, except "
    "records that don't fit in L2. What one kernel writes and the next reads counts as memory for both: small "
    "pictures, a small field's lists and, on the RTX 4090, the sums of a sweep stay in L2 and take less. That a store "
    "whose threads write far apart takes a cycle for each line is assumed.",
    "How unlike the tiles' lists are comes from a picture of 48 tiles; a large picture's longest list is longer.",
    "Branches within a warp: both sides are counted, except in the loop of `blend_backward`, whose branch is taken as "
    "often as measured, in the linear scatter's loops over windows, whose branches are taken where a source may reach "
    "the window, and in `add_to_planes`, of which programs without a sample skip most.",
    "Machine code is that for tensors that begin at multiples of 16 bytes and for any other numbers; Triton compiles "
    "anew for numbers that are 1 or multiples of 16, which may be a little faster.",
    "A field's samples are those of one scene with one preset; how they crowd decides about `add_to_planes`.",
    "One radius everywhere is the linear scatter's best case: where neighbours differ, more windows are divided.",
    "A launch's and a wait's time are assumed, and so are latencies of special functions, shuffles and float64. "
    "Torch's small operations were counted in trainings on the CPU, and Python may take longer for one than a launch.",
)


def gaussians(sizes: Sequence[Sizes], times: dict[tuple[str, str], list[Time]], totals: Sequence[Row]) -> list[str]:
    """Of Gaussians."""
    largest = "; ".join(
        f"`{name}` for "
        + ", ".join(
            f"{row['workload']} on the {row['gpu']} ({row['largest_percent']:.0f} %)"
            for row in of(totals, largest=name)
        )
        for name in sorted({str(row["largest"]) for row in totals})
    )
    waits = "; ".join(
        f"{one.name} {span(values(totals, 'blend_backward_waits_percent', workload=one.name))} %" for one in sizes
    )
    names = {one.name for one in sizes}
    bounds = sorted(
        {t.bound for (workload, _), many in times.items() for t in many
         if workload in names and t.label == "blend_backward"}
    )  # fmt: skip
    occupancy = values(totals, "blend_backward_occupancy_percent")
    apart, launch = values(totals, "apart_percent"), values(totals, "launch_percent")
    room = min(values(totals, "blend_backward_room"))
    few = sizes[0].tiles < room
    return [
        f"**What dominates.** The longest kernel, with its share of a step, is {largest}.",
        f"**Does the low occupancy of `blend_backward` matter?** With one warp for each tile it fills "
        f"{span(occupancy)} % of the warps that a multiprocessor holds. It is bound by {', '.join(bounds)}. "
        f"Warps that wait cost of its time: {waits}. More occupancy could gain no more than that: a thread's eight "
        "pixels don't depend on each other, so one warp has much to do while it waits."
        + (
            f" Where warps do wait, it isn't for lack of registers: {sizes[0].name} has {sizes[0].tiles} tiles and "
            f"so as many warps, the smallest of the GPUs has room for {room:.0f}, and the tile with the longest list "
            "ends last. Two warps for a tile would help there, fewer registers wouldn't."
        )
        * few,
        "**Numbers of one Gaussian that lie beside each other.** In `color` and `color_backward` each thread reads its "
        "own Gaussian's 45 coefficients and writes their gradients, so that every load and store of a warp touches 32 "
        "lines. If neighbouring threads took neighbouring numbers, a step would take up to "
        f"{max(apart):.0f} % less. `mix` has the same pattern in its logits.",
        "**A warp for each Gaussian.** `sum_slots` spends one on every Gaussian, visible or not, most of it on "
        f"instructions before and behind its loop: {span(values(totals, 'sum_slots_percent'))} % of a step. Several "
        "Gaussians for a warp would share them.",
        f"**Launches.** They are {span(launch)} % of a step, mostly torch's small operations and not these kernels. "
        "Where the share is large, a CUDA graph or fewer operations gain more than a faster kernel.",
    ]


def scatter(rows: Sequence[Row], crossings: Sequence[Row]) -> str:
    """Of its forms."""
    disc, hexagon = (values(crossings, "both_px", aperture=one) for one in ("disc", "hexagon"))
    forward, backward = (values(crossings, f"{way}_px") for way in ("forward", "backward"))
    still = max(radius for radius in values(rows, "radius") if radius + BAND < AUTO_REACH)
    change = {
        aperture: [
            100 * (float(str(row["linear_both_ms"])) / float(str(row["direct_both_ms"])) - 1)
            for row in of(rows, radius=still, aperture=aperture)
        ]
        for aperture in ("disc", "hexagon")
    }
    return (
        f"**The scatter's forms.** For one radius everywhere and with the gradient the linear form is the faster one "
        f"from {span(disc)} pixels on for discs and from {span(hexagon)} for hexagons, whose windows are bounded less "
        f"tightly: forward from {span(forward)}, the gradient alone from {span(backward)}. By instructions alone "
        "[the notes](../notes/gpu.md) say the same for discs on an H100, between 16 and 24 pixels. Training takes it "
        f"for tiles whose light goes {AUTO_REACH} pixels or farther. At a radius of {still:.0f} pixels, below that, it "
        f"would change the time by {span(change['disc'])} % for discs and by {span(change['hexagon'])} % for hexagons; "
        "but for a ramp of radii, which isn't modelled here, the notes have both forms equal only at 24 pixels."
    )


def lens_points(name: str, with_scatter: str, wholes: Sequence[Row]) -> str:
    """Of the rasteriser from points of the lens."""
    ratios = {
        column: [
            one / other
            for one, other in zip(
                values(wholes, column, workload=name), values(wholes, column, workload=with_scatter), strict=True
            )
        ]
        for column in ("forward_ms", "milliseconds")
    }
    return (
        f"**Points of the lens.** A picture from five points takes {span(ratios['forward_ms'], 1)} times as long as "
        f"one with the scatter, a training step {span(ratios['milliseconds'], 1)} times: five pictures' tiles fill the "
        "GPU, which one picture's don't, and projection, its gradient and the optimiser are shared."
    )


def fields(names: Sequence[str], times: dict[tuple[str, str], list[Time]], wholes: Sequence[Row]) -> str:
    """Of radiance fields."""
    shares = {
        kernel: [
            100 * sum(t.seconds for t in many if t.kernel == kernel and t.stage != "features") / whole
            for name in names
            for row in of(wholes, workload=name)
            for many, whole in [(times[name, str(row["gpu"])], 1e-3 * float(str(row["milliseconds"])))]
        ]
        for kernel in ("add_to_planes", "sort by cell", "smoothness", "Adam")
    }
    launch = [value for name in names for value in values(wholes, "launch_percent", workload=name)]
    return (
        f"**Fields.** `add_to_planes` takes {span(shares['add_to_planes'])} % of a step: a program sums at four "
        "nodes, and most of its instructions are spent before and behind the few samples that it finds. "
        f"Sorting samples by cell takes {span(shares['sort by cell'])} %, the planes' smoothness "
        f"{span(shares['smoothness'])} %, Adam {span(shares['Adam'])} %; launches are {span(launch)} %."
    )


def stereo(name: str, times: dict[tuple[str, str], list[Time]], wholes: Sequence[Row]) -> str:
    """Of plane-sweep stereo."""
    shares: dict[str, list[str]] = {"sweep": [], "paths": [], "check": []}
    for row in of(wholes, workload=name):
        many, whole = times[name, str(row["gpu"])], 1e-3 * float(str(row["milliseconds"]))
        for stage, words in shares.items():
            inner = [time for time in many if time.stage == stage]
            longest = max(inner, key=lambda time: time.seconds)
            percent = 100 * sum(time.seconds for time in inner) / whole
            words.append(f"{percent:.0f} % on the {row['gpu']} ({longest.bound})")
    sweep, paths, check = (", ".join(words) for words in shares.values())
    return (
        f"**Stereo.** Most of a view is its sweep, whose sums go through memory: {sweep}. The paths are a warp each, a "
        f"few hundred in all: {paths}; a warp waits for each step before it takes the next. The check is float64, of "
        f"which some GPUs do little: {check}."
    )


def points_of(*texts: str) -> str:
    """A list, in lines that a text editor shows."""
    items = (
        textwrap.fill(f"- {text}", 118, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        for text in texts
    )
    return "\n".join(items) + "\n"


def values(rows: Sequence[Row], column: str, **wanted: object) -> list[float]:
    """A column of the rows, or of those with some values; what isn't there is left out."""
    return [float(str(row[column])) for row in of(rows, **wanted) if row[column] is not None]


def span(numbers: Sequence[float], digits: int = 0) -> str:
    """The smallest and the largest of some values, or the one that they all are."""
    low, high = f"{min(numbers):.{digits}f}", f"{max(numbers):.{digits}f}"
    return low if low == high else f"{low} to {high}"
