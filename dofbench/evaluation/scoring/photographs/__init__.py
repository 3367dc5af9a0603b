"""Scores of photographs of unknown lens: lens and colours are fitted on one half of a photograph, and the prediction of
the other half is scored."""

from __future__ import annotations
