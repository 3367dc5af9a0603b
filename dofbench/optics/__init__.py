"""Defocus of images by a known lens: display encoding, scatter renderer, layered renderer, depth edges."""
