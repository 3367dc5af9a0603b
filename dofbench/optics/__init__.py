"""Blur of whole images by a known lens: encode and decode, scatter, layers, and where depth jumps."""
