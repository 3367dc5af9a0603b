"""report.html: one self-contained page that loads nothing from elsewhere, generated without external libraries."""
