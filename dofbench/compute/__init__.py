"""Threads, compiled code and its cache: what the kernels need of the machine."""
