"""Commands that combine several packages, one module each."""
