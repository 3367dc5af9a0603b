"""Tone curves between encoded values and linear light: a power with a straight toe, `tone`, with its gradient."""
