"""Scores of predictions, results and their protocols, and checks of renderers and numerical stability."""
