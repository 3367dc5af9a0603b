"""dofbench: datasets with a known lens, and a benchmark of depth-of-field-aware view synthesis.

`__init__.pyi` lists the public names, which other programs and `examples/` may use. A name is imported when it is first
used, so `import dofbench` is fast. Modules may change without an entry in CHANGELOG.md; these names don't.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
