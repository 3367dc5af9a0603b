"""Tone curves between encoded values and linear light: `tone`, a power with a linear toe, and its gradient."""
