"""validate-renderer: comparison of our renderers' blur with optical blur."""
