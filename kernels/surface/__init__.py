"""The disparity of rendered surfaces, circles of confusion and depth errors: `surface`, `circle`, `known_depth`."""
