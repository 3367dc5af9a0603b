"""Time of SSIM and of the whole colour loss, value and gradient, in every backend.

python benchmarks/ssim.py [--width 504] [--height 378] [--repeats 50]
"""

from __future__ import annotations

import argparse
import statistics
import time

from dofbench.compute.threads import configure_threads

configure_threads()  # before torch and numba are imported

import torch  # noqa: E402

from dofbench.kernels import backends, load  # noqa: E402


def milliseconds(step, repeats: int) -> tuple[float, float]:
    """(median, least) time of one call."""
    step()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        step()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times), min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=504)
    parser.add_argument("--height", type=int, default=378)
    parser.add_argument("--repeats", type=int, default=50)
    arguments = parser.parse_args()
    prediction, target = torch.rand(2, arguments.height, arguments.width, 3)
    weight = torch.rand(arguments.height, arguments.width)
    prediction.requires_grad_()

    def composed(ssim):
        l1 = ((prediction - target).abs() * weight[..., None]).mean()
        return 0.8 * l1 + 0.2 * (1 - ssim(prediction, target))

    size = f"{arguments.width} x {arguments.height} x 3"
    print(f"{size}, {torch.get_num_threads()} threads, milliseconds: median (least)")
    for backend in backends("ssim"):
        ssim, l1_ssim = load("ssim", backend), load("ssim", backend, function="l1_ssim")
        losses = {
            "ssim": lambda ssim=ssim: ssim(prediction, target),
            "weighted l1 + ssim": lambda ssim=ssim: composed(ssim),
            "l1_ssim, weighted": lambda l1_ssim=l1_ssim: l1_ssim(prediction, target, ssim_weight=0.2, weight=weight),
        }
        for name, loss in losses.items():
            with torch.no_grad():
                value = milliseconds(loss, arguments.repeats)
            both = milliseconds(lambda loss=loss: loss().backward(), arguments.repeats)
            columns = "   ".join(f"{median:7.2f} ({least:.2f})" for median, least in (value, both))
            print(f"{backend:10} {name:20} value, then with gradient: {columns}")


if __name__ == "__main__":
    main()
