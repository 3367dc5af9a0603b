"""GPUs by their published peak figures, and what of them code is taken to reach."""

from __future__ import annotations

from dataclasses import dataclass, replace

# A launch that nothing hides, seconds: what CUDA programs commonly measure for an empty kernel; an assumption here.
LAUNCH = 3e-6
# The host reads one number of the device: everything queued is waited for, and the queue is empty afterwards. Assumed.
WAIT = 10e-6
# Share of a GPU's bandwidth that a radix sort reaches. Adinets and Merrill (Onesweep: A Faster Least Significant Digit
# Radix Sort for GPUs, 2022) report 29.4e9 keys of 32 bits a second on an A100 with 1555 GB/s. A key is read once for
# its histogram, and read and written in each of four passes of 8 bits: 36 bytes, so 1058 GB/s, 68 %.
SORT_SHARE = 29.4e9 * 36 / 1555e9


@dataclass(frozen=True)
class Gpu:
    """A GPU at its boost clock.

    architecture: compute capability times ten, for which kernels are compiled. bandwidth: of its memory, bytes a
    second. multiprocessors: how many. clock: cycles a second. l2: size of its L2 cache, bytes. fma, double: warp
    instructions a cycle that one multiprocessor's units for products and sums of floats and of float64 take; those of
    the other units are alike on all three (alu, special, memory below, and four issued in all).
    """

    name: str
    architecture: int
    bandwidth: float
    multiprocessors: int
    clock: float
    l2: float
    fma: float
    double: float
    alu: float = 2.0
    special: float = 0.5
    memory: float = 1.0
    issue: float = 4.0


# Rates of units: CUDA C++ Programming Guide, table "Throughput of Native Arithmetic Instructions": 64 float32 products
# and sums a cycle for compute capability 8.0, 128 for 8.9 and 9.0; of float64 32, 2 and 64 for 8.0, 8.9 and 9.0; 64
# integer sums, comparisons and shifts; 16 special functions; 32 shuffles, and as many loads.
GPUS = (
    # NVIDIA A100 datasheet (80 GB SXM: 2039 GB/s) and A100 architecture white paper (108 multiprocessors, boost
    # 1410 MHz, L2 40 MB).
    Gpu("A100-SXM4-80GB", 80, 2039e9, 108, 1.41e9, 40e6, 2.0, 1.0),
    # NVIDIA H100 datasheet (SXM5: 3.35 TB/s; 66.9 float32 TFLOP/s with 132 multiprocessors are 1980 MHz) and H100
    # architecture white paper (132 multiprocessors, L2 50 MB).
    Gpu("H100-SXM5", 90, 3350e9, 132, 1.98e9, 50e6, 4.0, 2.0),
    # NVIDIA Ada GPU architecture white paper (RTX 4090: 1008 GB/s, 128 multiprocessors, boost 2520 MHz, L2 72 MB).
    Gpu("RTX 4090", 89, 1008e9, 128, 2.52e9, 72e6, 4.0, 1 / 16),
)
# NVIDIA H200 datasheet: an H100 SXM5 with 4.8 TB/s. In no table; for comparison with what is measured on one.
H200 = replace(GPUS[1], name="H200", bandwidth=4800e9)
