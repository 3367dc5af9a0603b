"""Gaussian splatting: the model, the trainer and what Gaussian methods share."""
