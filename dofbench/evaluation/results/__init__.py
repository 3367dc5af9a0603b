"""Finished runs on disk: their settings, provenance and scores; and collecting many of them."""
