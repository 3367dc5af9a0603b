"""A dataset's folder: its files, its schema, and the reader. How datasets are made is up to other packages."""
