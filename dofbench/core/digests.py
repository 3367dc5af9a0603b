"""A JSON file that holds the digest of its own text, so that every later change of it is noticed.

This guards against damage and careless edits. Whoever means to deceive can compute the digest anew.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_text, write_text

FIELD = "digest"
_BLANK = "0" * 64
_DIGEST = re.compile(r"[0-9a-f]{64}")


def write_with_digest(path: Path, value: Mapping[str, Any]) -> None:
    """Write indented JSON, atomically, with the field `digest`: sha256 of the text in which the digest is all zeros."""
    content = {key: item for key, item in value.items() if key != FIELD} | {FIELD: _BLANK}
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    # Strings have no line breaks in JSON, and what is nested is indented further: there is one such place.
    before, line, after = text.rpartition(f'\n  "{FIELD}": "{_BLANK}"')
    write_text(path, before + line.replace(_BLANK, sha256_text(text)) + after)


def require_digest(path: Path, data: Mapping[str, Any], *, expected: str) -> None:
    """Raise InputError unless the text of the file is the one whose digest `data`, its content, holds."""
    stored = data.get(FIELD)
    try:
        text = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"nothing readable ({error})", expected) from None
    whole = isinstance(stored, str) and _DIGEST.fullmatch(stored) is not None and text.count(stored) == 1
    if not whole or sha256_text(text.replace(str(stored), _BLANK)) != stored:
        raise InputError(path, "a file that was changed after it was written (its digest is another one)", expected)
