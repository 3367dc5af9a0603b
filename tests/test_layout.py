"""Content folders never hide a package of the same name, and imported packages are declared."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

from dofbench.core.content import FOLDERS

ROOT = Path(__file__).resolve().parent.parent
TOP_FOLDERS = tuple(dict.fromkeys(folder.partition("/")[0] for folder in FOLDERS))


def test_content_folders_do_not_shadow_packages_of_the_same_name(tmp_path: Path) -> None:
    """A registry package called `datasets` must win, wherever the checkout stands on the import path."""
    for name in TOP_FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    script = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); sys.path.append({str(tmp_path)!r})\n"
        "import dofbench.runtime.ops\n"
        f"for name in {TOP_FOLDERS!r}: assert __import__(name).__file__.startswith({str(tmp_path)!r}), name"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_every_imported_package_is_declared() -> None:
    """Otherwise an installation without the extra `test` would fail at that import."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    users = [name for name in extras if name not in ("test", "dev", "docs")]
    wanted = project["dependencies"] + [entry for name in users for entry in extras[name]]
    declared = {re.split(r"[^A-Za-z0-9._-]", entry, maxsplit=1)[0].lower().replace("_", "-") for entry in wanted}
    providers = packages_distributions()
    for path in [
        path for folder in ("dofbench", "kernels", "methods", "datasets") for path in (ROOT / folder).rglob("*.py")
    ]:
        modules = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                modules.add(node.module)
        for top in {module.split(".")[0] for module in modules} - sys.stdlib_module_names - {"dofbench"}:
            beside = (path.parent / top).is_dir() or (path.parent / f"{top}.py").is_file()  # a script's own
            found = {name.lower().replace("_", "-") for name in providers.get(top, [top])}
            assert beside or found & declared, f"{path.relative_to(ROOT)} imports {top}, not declared in pyproject.toml"
