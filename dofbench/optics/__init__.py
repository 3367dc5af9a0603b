"""Blur of whole images by a known lens: display encoding, scatter, layered rendering, depth edges."""
