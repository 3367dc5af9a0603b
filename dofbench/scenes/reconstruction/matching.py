"""Matches between photographs, checked by the geometry of two views; pair by pair, so that a run can go on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from dofbench.scenes.reconstruction.features import read
from dofbench.scenes.reconstruction.interruptible import Wait
from dofbench.scenes.reconstruction.pairs import (
    LOOK_ALIKES,
    LOOPS,
    Pair,
    exhaustive,
    look_alikes,
    sequential,
    signatures,
)
from dofbench.scenes.reconstruction.photograph_list import Prepared
from dofbench.scenes.reconstruction.reconstruct_options import Matching

# Pairs a call: enough that starting one costs nothing, few enough that progress is seen.
_AT_ONCE = 24


def choose_pairs(matching: Matching, database: Path, photographs: Sequence[Prepared], seed: int) -> list[Pair]:
    """The pairs to compare, by index into `photographs`; `matching` is not auto any more."""
    count = len(photographs)
    if matching == "exhaustive":
        return exhaustive(count)
    vectors = signatures([descriptors for _, _, descriptors in read(database, photographs)], seed)
    if matching == "retrieval":
        # The neighbours in order too: photographs are taken one after the other.
        return sorted({*look_alikes(vectors, LOOK_ALIKES), *((index, index + 1) for index in range(count - 1))})
    return sorted({*sequential(count), *look_alikes(vectors, LOOPS)})


def match(
    database: Path,
    photographs: Sequence[Prepared],
    pairs: Sequence[Pair],
    work: Path,
    *,
    seed: int,
    wait: Wait,
    advance: Callable[[int], None],
    error: float | None = None,
) -> None:
    """Match the pairs and keep what one geometry explains; pairs that the database has are passed over.

    work: folder for the list of pairs. advance: called with the number of pairs done. error: pixels by which a match
    may miss the geometry; None for COLMAP's own.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    matching = pycolmap.FeatureMatchingOptions()
    # With several threads COLMAP's search for similar features finds others now and then: with two, in 2 of 250 runs
    # over 4 small photographs.
    matching.num_threads = 1
    geometry = pycolmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = seed
    if error is not None:
        geometry.ransac.max_error = error
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = work / "pairs.txt"
    for start in range(0, len(pairs), _AT_ONCE):
        some = pairs[start : start + _AT_ONCE]
        lines = [f"{photographs[first].file_name} {photographs[second].file_name}" for first, second in some]
        pairing.match_list_path.write_text("\n".join(lines) + "\n")
        wait(
            lambda: pycolmap.match_image_pairs(
                database, matching_options=matching, pairing_options=pairing, verification_options=geometry
            )
        )
        advance(start + len(some))


def verified(database: Path, photographs: Sequence[Prepared]) -> dict[Pair, int]:
    """Matches that one geometry explains, by pair of indices into `photographs`; pairs without any are left out."""
    from dofbench.scenes.colmap_binding import pycolmap

    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        keys, numbers = opened.read_two_view_geometry_num_inliers()
    index = {ids[photograph.file_name]: place for place, photograph in enumerate(photographs)}
    found = {}
    for key, number in zip(keys, numbers, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(key)
        if number:
            found[min(index[first], index[second]), max(index[first], index[second])] = int(number)
    return found
