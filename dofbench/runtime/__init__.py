"""What kernels are built on: threads, devices, compiled code and its cache on disk, SIMD vectors."""
