"""Finding and loading methods. A method folder `methods/<id>/` is importable as `dofbench.methods.<id>`."""

from dofbench.core.content import method_folders

__path__ = [*__path__, *(str(folder) for folder in method_folders())]
