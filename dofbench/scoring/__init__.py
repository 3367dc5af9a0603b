"""Scores of a method on a dataset: predictions against truth, photographs without truth, lenses, consistency."""
