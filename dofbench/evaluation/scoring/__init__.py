"""Scores of a method on a dataset: predictions, real photographs, learned lenses; and the consistency of results."""
