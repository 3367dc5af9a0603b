"""What one command composes of several packages."""
