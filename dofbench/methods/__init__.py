"""Makes the method folders `methods/<id>/` importable as `dofbench.methods.<id>`."""

from dofbench.core.content import method_folders

__path__ = [str(folder) for folder in method_folders()]
