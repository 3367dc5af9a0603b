"""transforms.json of four views, which tests change."""

import json

FILES = [f"images/{index}.png" for index in range(4)]


def edit(folder, change):
    """Change the parsed file in place and write it back."""
    file = folder / "transforms.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
