"""Compares runs: means over seeds and scenes, paired differences, and scores against training time."""
