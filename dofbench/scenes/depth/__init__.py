"""Where a dataset's depth comes from: one source a file, all giving z-depth maps of the scene's views."""
