"""Tone curves between encoded values and linear light: `tone`."""
