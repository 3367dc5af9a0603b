"""Error and time of the scatter's two forms by the largest radius, and from which radius on the linear form is faster.

    python benchmarks/scatter.py [--width 504] [--height 378] [--repeats 9] [--radii 4,8,16,32,64,128]

Errors are the largest over random pixels, relative to the array's largest magnitude, against float64 sums over
the whole image: of sources for values, of targets for gradients.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time

from dofbench.compute.threads import configure_threads

configure_threads()  # before torch and numba are imported

import numpy as np  # noqa: E402
import torch  # noqa: E402

from dofbench.core.lens import ALPHA, AREA_EPSILON  # noqa: E402
from dofbench.kernels import load  # noqa: E402
from dofbench.optics.defocus import defocus  # noqa: E402

FORMS = ("direct", "linear")
SAMPLES = 40
scatter = load("scatter", "cpu")


def surfaces(rng, height: int, width: int) -> np.ndarray:
    """Smooth waves with a depth edge across them, [0, 1], similar to a disparity map."""
    rows, columns = np.mgrid[:height, :width] / width
    waves = sum(
        np.cos(2 * np.pi * (rng.uniform(-3, 3) * rows + rng.uniform(-3, 3) * columns + rng.random())) for _ in range(6)
    )
    waves = (waves - waves.min()) / np.ptp(waves)
    return np.where(columns + 0.4 * rows > 0.6, 1 - waves, waves)


def run(function, image, radius, gradient):
    """(forward ms, backward ms, blurred, gradient with respect to image, gradient with respect to radius)."""
    image, radius = (t.detach().requires_grad_() for t in (image, radius))
    start = time.perf_counter()
    blurred = function(image, radius)
    middle = time.perf_counter()
    blurred.backward(gradient)
    end = time.perf_counter()
    return 1e3 * (middle - start), 1e3 * (end - middle), blurred, image.grad, radius.grad


def weights(radius, distance):
    """Weight and its derivative with respect to the radius, float64."""
    soft = 1 / (1 + np.exp(np.clip(2 * ALPHA * (distance - radius), -700, 700)))
    share = 1 / (radius**2 + AREA_EPSILON)
    return soft * share, 2 * ALPHA * soft * (1 - soft) * share - 2 * radius * share**2 * soft


def errors(image, radius, gradient, outputs, rng) -> list[float]:
    """Errors of values, gradient with respect to image, and gradient with respect to radius."""
    image, radius, gradient = (t.detach().double().numpy() for t in (image, radius, gradient))
    # The backward pass starts from these sums; their error is that of the first column.
    blurred, total = (a.astype(np.float64) for a in outputs[0].grad_fn.sums)
    by_sum = gradient / total[..., None]
    rows, columns = np.mgrid[: radius.shape[0], : radius.shape[1]]
    outputs = [t.detach().double().numpy() for t in outputs]
    worst = np.zeros(3)
    for _ in range(SAMPLES):
        y, x = (int(rng.integers(size)) for size in radius.shape)
        distance = np.hypot(rows - y, columns - x)
        arriving, _ = weights(radius, distance)
        leaving, slope = weights(radius[y, x], distance)
        exact = (
            (arriving[..., None] * image).sum(axis=(0, 1)) / arriving.sum(),
            (leaving[..., None] * by_sum).sum(axis=(0, 1)),
            (slope * (by_sum * (image[y, x] - blurred)).sum(axis=2)).sum(),
        )
        found = [np.abs(output[y, x] - value).max() for output, value in zip(outputs, exact, strict=True)]
        worst = np.maximum(worst, found)
    return [error / np.abs(output).max() for error, output in zip(worst, outputs, strict=True)]


def table(kind: str, disparity: np.ndarray, radii: list[float], repeats: int, rng) -> None:
    """Print times and errors by largest radius; both forms are interleaved, so that changes of the machine's speed
    affect both."""
    image, gradient = (torch.from_numpy(rng.random((*disparity.shape, 3)).astype(np.float32)) for _ in range(2))
    print(f"\n{kind}\n")
    heads = [f"{form} {column}" for form in FORMS for column in ("fwd ms", "bwd ms", "error", "by c", "by R")]
    print("| R_max |", " | ".join(heads), "|\n|" + " --- |" * (1 + len(heads)))
    faster = None
    for largest in radii:
        radius = torch.from_numpy((largest * disparity).astype(np.float32))
        times, cells = {form: [] for form in FORMS}, []
        for repeat in range(repeats + 1):
            for form in FORMS:
                forward, backward, *outputs = run(lambda c, s, f=form: scatter(c, s, form=f), image, radius, gradient)
                if repeat == 0:  # the first round compiles
                    cells.append(errors(image, radius, gradient, outputs, np.random.default_rng(1)))
                else:
                    times[form].append((forward, backward))
        medians = {form: [statistics.median(t) for t in zip(*times[form], strict=True)] for form in FORMS}
        row = [
            text
            for form, error in zip(FORMS, cells, strict=True)
            for text in (*(f"{t:.1f}" for t in medians[form]), *(f"{e:.0e}" for e in error))
        ]
        print(f"| {largest:g} |", " | ".join(row), "|", flush=True)
        if faster is None and sum(medians["linear"]) < sum(medians["direct"]):
            faster = largest
    print(f"\nThe linear form is the faster one, forward and backward together, from R_max = {faster}.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=504)
    parser.add_argument("--height", type=int, default=378)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--radii", default="4,8,16,32,64,128")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    shape = arguments.height, arguments.width
    radii = [float(r) for r in arguments.radii.split(",")]
    print(
        f"{arguments.width} x {arguments.height} x 3, {torch.get_num_threads()} threads, medians of "
        f"{arguments.repeats}, load {os.getloadavg()[0]:.1f}"
    )
    table("Smooth surfaces with an edge", surfaces(rng, *shape), radii, arguments.repeats, rng)
    table("Noise as disparity", rng.random(shape), radii, arguments.repeats, rng)

    image, gradient = (torch.from_numpy(rng.random((*shape, 3)).astype(np.float32)) for _ in range(2))
    radius = torch.from_numpy(rng.uniform(0.0, 8.0, shape).astype(np.float32))
    print("\n| R uniform in [0, 8] | fwd median ms | fwd least | bwd median | bwd least |\n|" + " --- |" * 5)
    for name, function in (("scatter", scatter), ("defocus, with decoding and encoding", defocus)):
        rounds = [run(function, image, radius, gradient)[:2] for _ in range(3 * arguments.repeats)][3:]
        cells = [f"{of(column):.1f}" for column in zip(*rounds, strict=True) for of in (statistics.median, min)]
        print(f"| {name} |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
