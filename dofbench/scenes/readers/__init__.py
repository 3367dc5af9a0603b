"""One module for each scene layout, and what readers share."""
