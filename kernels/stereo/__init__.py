"""Plane-sweep stereo: `stereo`, `upsample`, `semiglobal` and `returns`."""
