"""validate-renderer: compare the renderers with optical blur."""
