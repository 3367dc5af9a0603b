"""Light fields: views on a regular grid; their calibration, their disparity, and photographs averaged from them."""
