"""Methods that are another program: it is given a folder, and its pictures are scored."""
