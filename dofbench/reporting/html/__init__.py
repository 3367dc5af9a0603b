"""report.html: one page with everything in it, written by our own code; it asks for nothing from anywhere."""
