"""Scores of real photographs of unknown lens: lens and colours are fitted on one half, the other half is scored."""
