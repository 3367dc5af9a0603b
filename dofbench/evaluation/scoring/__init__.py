"""Scores of a method on a dataset: predictions against ground truth, photographs of unknown lens, learned lenses, and
the consistency of results."""
