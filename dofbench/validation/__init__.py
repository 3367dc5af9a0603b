"""validate-renderer: the blur of our renderers against photographs whose blur is optical."""
