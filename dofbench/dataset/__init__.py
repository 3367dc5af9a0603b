"""A dataset's folder: its files, its schema, and the reader. Knows nothing of how a dataset is made."""
