"""Colour, transfer functions and metadata of image files."""
