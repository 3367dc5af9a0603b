"""A finished run on disk: what was asked, where it comes from, its scores; and collecting many of them."""
