"""An image's colours, each mixed from its three channels in the same way: `colours`."""
