"""Error against time of renderers and kernels for different quality settings: work-precision.csv, .md and .png.

    python benchmarks/work_precision.py --out reports/work-precision

Everything is measured in one run on one thread pool; the variants of a panel alternate, and medians of several rounds
are reported. Panels: scatter by the width of its soft band, both forms, against float64 sums over the whole image;
photographs by their resolution, against full size; the thin lens of training by its number of points, against 469; the
rasteriser's float32 kernel, against float64. Layers and rays of the dataset builder are in `dofbench
validate-renderer`, against optics.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

from dofbench.compute.threads import configure_threads

configure_threads()  # before torch and numba are imported

import numpy as np  # noqa: E402
import torch  # noqa: E402
import tyro  # noqa: E402
from dofbench.kernels.scatter import cpu_pack  # noqa: E402
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: E402
from scatter import surfaces, weights  # noqa: E402  - the benchmark beside this one

from dofbench.core.content import content_folder  # noqa: E402
from dofbench.core.contracts import PointCloud  # noqa: E402
from dofbench.core.files import write_text  # noqa: E402
from dofbench.core.images import resize  # noqa: E402
from dofbench.core.lens import GAMMA, DisparityRange, Lens  # noqa: E402
from dofbench.gaussians.exposure import StillRasteriser  # noqa: E402
from dofbench.gaussians.forward.lens_pattern import points_of  # noqa: E402
from dofbench.gaussians.forward.lens_samples import together, views_from_lens  # noqa: E402
from dofbench.gaussians.forward.shot import Shot  # noqa: E402
from dofbench.gaussians.model import Gaussians  # noqa: E402
from dofbench.gaussians.render import AppearanceOptions, rasterise  # noqa: E402
from dofbench.kernels import load  # noqa: E402
from dofbench.optics.defocus import defocus_numpy  # noqa: E402
from dofbench.reporting.csv_writer import write_csv  # noqa: E402
from dofbench.reporting.figures import look, new_figure, save  # noqa: E402
from dofbench.scenes import load_scene  # noqa: E402

WIDTH, HEIGHT = 504, 378
PIXELS = 60  # number of pixels at which the scatter is compared with sums over the whole image


@dataclass(frozen=True)
class Settings:
    """Where to write, and how often to measure."""

    out: Path
    """Folder for the table and the plot."""
    repeats: int = 7
    """Number of rounds, of which medians are reported."""


@dataclass(frozen=True)
class Point:
    """One measured variant. error: in the unit `unit`. seconds: median time of the forward pass."""

    panel: str
    line: str
    knob: str
    error: float
    unit: str
    seconds: float


def main(settings: Settings) -> None:
    """Measure all panels and write them."""
    points = [point for panel in (_bands, _resolutions, _lens_points, _rasteriser) for point in panel(settings.repeats)]
    settings.out.mkdir(parents=True, exist_ok=True)
    write_csv(settings.out / "work-precision.csv", tuple(f.name for f in fields(Point)), [vars(one) for one in points])
    lines = ["| what | variant | knob | error | | ms |", "| :--- | :--- | :--- | ---: | :--- | ---: |"]
    for p in points:
        error = f"{p.error:.2g}" if np.isfinite(p.error) else "the reference"
        lines.append(f"| {p.panel} | {p.line} | {p.knob} | {error} | {p.unit} | {1e3 * p.seconds:.1f} |")
    write_text(settings.out / "work-precision.md", "\n".join(lines) + "\n")
    _plot(points, settings.out / "work-precision.png")


def _medians(variants: dict, repeats: int) -> dict:
    """Median seconds of each variant; the variants alternate, after one round that compiles."""
    times: dict = {name: [] for name in variants}
    for round_ in range(repeats + 1):
        for name, call in variants.items():
            start = time.perf_counter()
            call()
            if round_:
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def _bands(repeats: int) -> list[Point]:
    """The scatter by the width of its soft band, which ends where the weight is e to minus an exponent."""
    rng = np.random.default_rng(0)
    scatter, usual = load("scatter", "cpu"), cpu_pack.BAND_EXPONENT
    disparity = surfaces(rng, HEIGHT, WIDTH)
    image = torch.from_numpy(rng.random((HEIGHT, WIDTH, 3)).astype(np.float32))
    points = []
    for largest in (8.0, 64.0):
        radius = torch.from_numpy((largest * disparity).astype(np.float32))
        exact = _exact(image, radius, np.random.default_rng(1))

        def blurred(form: str, exponent: float, radius=radius):
            cpu_pack.BAND_EXPONENT = exponent
            try:
                return scatter(image, radius, form=form)
            finally:
                cpu_pack.BAND_EXPONENT = usual

        knobs = [(form, exponent) for form in ("direct", "linear") for exponent in (3.0, 5.0, 7.0, 9.0, usual, 16.0)]
        seconds = _medians({knob: lambda knob=knob, b=blurred: b(*knob) for knob in knobs}, repeats)
        for form, exponent in knobs:
            found = blurred(form, exponent).double().numpy()
            error = max(np.abs(found[y, x] - value).max() for (y, x), value in exact.items()) / np.abs(found).max()
            points.append(
                Point(
                    f"scatter, R ≤ {largest:g} px",
                    f"{form} form",
                    f"{exponent:g}",
                    float(error),
                    "largest, relative",
                    seconds[form, exponent],
                )
            )
    return points


def _exact(image, radius, rng) -> dict:
    """Pixel -> its colour by a sum over the whole image in float64."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    colours, radii, found = image.double().numpy(), radius.double().numpy(), {}
    for _ in range(PIXELS):
        y, x = int(rng.integers(HEIGHT)), int(rng.integers(WIDTH))
        share, _ = weights(radii, np.hypot(rows - y, columns - x))
        found[y, x] = (share[..., None] * colours).sum(axis=(0, 1)) / share.sum()
    return found


def _resolutions(repeats: int) -> list[Point]:
    """The whole photograph, computed at a share of its size and enlarged, compared with full size."""
    scene = load_scene(content_folder("datasets") / "tabletop")
    view = scene.views[0]
    image, depth = view.image(), view.depth()
    bounds = DisparityRange.of_disparity(1 / depth[depth > 0])
    height, width = depth.shape
    points = []
    for focus in (0.2, 0.8):

        def shot(share: int, lens=Lens(1.0, focus)) -> np.ndarray:
            if share == 1:
                return defocus_numpy(image, depth, lens.physical(bounds, width))[0]
            small = resize(image, width // share, height // share)
            nearest = depth[share // 2 :: share, share // 2 :: share][: height // share, : width // share]
            return resize(defocus_numpy(small, nearest, lens.physical(bounds, width // share))[0], width, height)

        shares = (1, 2, 4)
        seconds = _medians({share: lambda share=share, s=shot: s(share) for share in shares}, repeats)
        full = shot(1)
        points += [
            Point(
                "photograph by resolution",
                f"F = {focus:g}",
                f"1/{share}",
                float(np.sqrt(((shot(share) - full) ** 2).mean())) or np.nan,
                "RMSE",
                seconds[share],
            )
            for share in shares
        ]
    return points


def _scene() -> tuple[Gaussians, object, DisparityRange]:
    """Gaussians at the built-in scene's sparse points; renderings can be compared without training."""
    scene = load_scene(content_folder("datasets") / "tabletop")
    view = scene.views[0]
    disparity = 1 / view.depth()
    cloud = PointCloud(scene.points.xyz, scene.points.rgb, scene.points.error)
    gaussians = Gaussians.from_points(cloud, 0)
    with torch.no_grad():
        gaussians.parameters["opacity_logits"].fill_(2.0)
    gaussians.update_filter_3d([view.camera])
    return gaussians, view.camera, DisparityRange.of_disparity(disparity)


@torch.no_grad()
def _lens_points(repeats: int) -> list[Point]:
    """Views from points of the lens: 1, 5, 19, 37, 61, 91 of them, each blurred by its cell."""
    gaussians, camera, bounds = _scene()
    scene = StillRasteriser(gaussians, AppearanceOptions(sh_degree=0))
    shot = Shot(camera, bounds, 1.0, -0.3)

    def photograph(rings: int) -> np.ndarray:
        return together(views_from_lens(scene, shot, rings, to_depth=False), GAMMA).numpy()

    rings = range(6)
    seconds = _medians({ring: lambda ring=ring: photograph(ring) for ring in rings}, repeats)
    finest = photograph(12)
    errors = {ring: float(np.sqrt(((photograph(ring) - finest) ** 2).mean())) for ring in rings}
    return [
        Point(
            "lens by its points",
            "points and cells",
            str(points_of(ring)),
            errors[ring],
            "RMSE",
            seconds[ring],
        )
        for ring in rings
    ]


@torch.no_grad()
def _rasteriser(repeats: int) -> list[Point]:
    """The kernel and the definition in float32, compared with the definition in float64, at a size that the definition
    can process."""
    gaussians, camera, _ = _scene()
    camera = camera.resized(camera.width // 4, camera.height // 4)
    options = AppearanceOptions(sh_degree=0)
    double = {name: tensor.detach().double() for name, tensor in gaussians.parameters.items()}
    reference = load("rasterize", "reference")

    def defined(kind: Callable) -> np.ndarray:
        one = {name: kind(tensor) for name, tensor in double.items()}
        return (
            reference(
                **one,
                camera=camera,
                sh_degree=0,
                geometry="none",
                filter_3d=kind(gaussians.filter_3d),
                filter_2d=options.filter_2d,
            )
            .color.double()
            .numpy()
        )

    variants = {
        "kernel, float32": lambda: rasterise(gaussians, camera, options, geometry="none").color.double().numpy(),
        "definition, float32": lambda: defined(torch.Tensor.float),
        "definition, float64": lambda: defined(torch.Tensor.double),
    }
    seconds = _medians(variants, min(repeats, 3))
    exact = variants["definition, float64"]()
    return [
        Point("rasteriser", name, "", float(np.sqrt(((call() - exact) ** 2).mean())) or np.nan, "RMSE", seconds[name])
        for name, call in variants.items()
    ]


def _plot(points: list[Point], path: Path) -> None:
    panels = list(dict.fromkeys(point.panel for point in points))
    figure = new_figure(3.1 * len(panels), 3.2)
    for axes, panel in zip(figure.subplots(1, len(panels)), panels, strict=True):
        some = [point for point in points if point.panel == panel]
        for index, line in enumerate(dict.fromkeys(point.line for point in some)):
            found = [point for point in some if point.line == line and np.isfinite(point.error)]
            axes.plot(
                [1e3 * p.seconds for p in found],
                [p.error for p in found],
                marker="o",
                markersize=4,
                label=line,
                **look(index),
            )
            for p in found:
                axes.annotate(p.knob, (1e3 * p.seconds, p.error), textcoords="offset points", xytext=(3, 3), fontsize=7)
        axes.set(
            xscale="log",
            yscale="log",
            xmargin=0.2,
            ymargin=0.2,
            title=panel,
            xlabel="time [ms]",
            ylabel=f"error ({some[0].unit})",
        )
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 100 * low else (1,)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
        axes.legend(fontsize=7)
    save(figure, path)


if __name__ == "__main__":
    main(tyro.cli(Settings))
