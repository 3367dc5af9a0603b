"""Declared tables of switches, run over datasets and seeds, beside the published figures."""
