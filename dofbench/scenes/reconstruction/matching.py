"""Match photographs: features, pairs to compare, matches verified by two-view geometry."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dofbench.core.progress import Progress
from dofbench.runtime.threads import available_cores
from dofbench.scenes.reconstruction.features import CameraGroup, FeatureCount, extract, read, register_images
from dofbench.scenes.reconstruction.kept_steps import wait
from dofbench.scenes.reconstruction.photograph_list import MASKS, Prepared
from dofbench.scenes.reconstruction.reconstruct_options import Matching, Reconstruct

Pair = tuple[int, int]

# Up to here all pairs are compared: 3 160 of them.
EXHAUSTIVE = 80
# How many of the most similar photographs each one is compared with; and in a sequence, where neighbours are
# compared anyway, how many more to close loops.
LOOK_ALIKES, LOOPS = 20, 4
# In a sequence: how many neighbours each photograph is compared with, and which farther ones.
_OVERLAP, _FARTHER = 10, (16, 32, 64)
_WORDS, _SAMPLE, _ROUNDS = 64, 40_000, 12
# Pairs a call: enough that starting one costs nothing, few enough that progress is seen.
_AT_ONCE = 24


@dataclass(frozen=True)
class Compared:
    """features: of every photograph, by name. matching: how pairs were chosen. pairs: by index into the photographs."""

    features: dict[str, FeatureCount]
    matching: Matching
    pairs: list[Pair]


def compare(
    database: Path,
    folder: Path,
    photographs: Sequence[Prepared],
    groups: Sequence[CameraGroup],
    progress: Progress,
    settings: Reconstruct,
    *,
    video: bool = False,
    error: float | None = None,
    timed: Callable[[str], AbstractContextManager[None]] = lambda stage: nullcontext(),
) -> Compared:
    """Find and match unmasked features of `photographs`, in `folder`; what the database has is kept.

    groups: the cameras; none where all poses are known. error: pixels by which a match may miss the two-view geometry;
    None for COLMAP's own. timed: measures the stages "features" and "matches".
    """
    told = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    threads = max(1, int(told)) if told.isdigit() else available_cores()
    masks = folder.parent / MASKS
    with timed("features"), progress.stage("features", len(photographs)) as advance:
        register_images(database, folder, photographs, groups, settings.camera_model)
        most = settings.features
        features = extract(database, folder, photographs, most=most, threads=threads, advance=advance, masks=masks)
    mode = choose(settings.matching, len(photographs), video)
    with timed("matches"):
        pairs = choose_pairs(mode, database, photographs, settings.seed)
        with progress.stage("matches", len(pairs)) as advance:
            match(database, photographs, pairs, database.parent, seed=settings.seed, advance=advance, error=error)
    return Compared(features, mode, pairs)


def choose(matching: Matching, count: int, video: bool) -> Matching:
    """Resolve `auto` for so many photographs."""
    if matching != "auto":
        return matching
    return "exhaustive" if count <= EXHAUSTIVE else "sequential" if video else "retrieval"


def choose_pairs(matching: Matching, database: Path, photographs: Sequence[Prepared], seed: int) -> list[Pair]:
    """The pairs to compare, by index into `photographs`; `matching` is resolved by `choose`."""
    count = len(photographs)
    if matching == "exhaustive":
        return exhaustive(count)
    vectors = signatures([descriptors for _, _, descriptors in read(database, photographs)], seed)
    if matching == "retrieval":
        # The neighbours in order too: photographs are taken one after the other.
        return sorted({*look_alikes(vectors, LOOK_ALIKES), *((index, index + 1) for index in range(count - 1))})
    return sorted({*sequential(count), *look_alikes(vectors, LOOPS)})


def exhaustive(count: int) -> list[Pair]:
    """All pairs of `count` photographs."""
    return [(first, second) for first in range(count) for second in range(first + 1, count)]


def sequential(count: int) -> list[Pair]:
    """Each with the ten after it, and with those 16, 32 and 64 after it."""
    offsets = [*range(1, _OVERLAP + 1), *_FARTHER]
    return sorted((first, first + offset) for offset in offsets for first in range(count - offset))


def look_alikes(signatures: np.ndarray, partners: int) -> list[Pair]:
    """Every photograph with the `partners` whose signatures (N, D), of unit length, are most like its own."""
    likeness = signatures @ signatures.T
    np.fill_diagonal(likeness, -np.inf)
    # Rounded, and equal ones in order, so that the last bits of a product decide nothing.
    order = np.argsort(-np.round(likeness, 6), axis=1, kind="stable")[:, : min(partners, len(signatures) - 1)]
    return sorted({(min(i, int(j)), max(i, int(j))) for i, row in enumerate(order) for j in row})


def signatures(descriptors: Sequence[np.ndarray], seed: int) -> np.ndarray:
    """(N, D) float32 of unit length: each photograph's features, (n, 128), as one VLAD vector (Jegou et al. 2010).

    Residuals to the nearest of 64 words, summed by word, each sum of one length (Arandjelovic and Zisserman 2013), then
    the whole. The words are found by k-means on a sample of all features.
    """
    generator = np.random.default_rng(seed)
    whole = [_normalised(each) for each in descriptors]
    everything = np.concatenate([*whole, np.zeros((0, 128), np.float32)])
    if len(everything) == 0:
        return np.zeros((len(descriptors), 1), np.float32)
    sample = everything[np.sort(generator.permutation(len(everything))[:_SAMPLE])]
    words = _words(sample, generator)
    found = np.zeros((len(whole), len(words), sample.shape[1]), np.float32)
    for row, each in zip(found, whole, strict=True):
        if len(each):
            np.add.at(row, nearest := _nearest(each, words), each - words[nearest])
    found /= np.maximum(np.linalg.norm(found, axis=2, keepdims=True), 1e-12)
    flat = found.reshape(len(found), -1)
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)


def _words(sample: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """k-means by Lloyd's rounds from a random choice; an empty word is replaced by a random sample."""
    words = sample[np.sort(generator.permutation(len(sample))[:_WORDS])].copy()
    for _ in range(_ROUNDS):
        nearest = _nearest(sample, words)
        for index in range(len(words)):
            members = sample[nearest == index]
            words[index] = members.mean(axis=0) if len(members) else sample[generator.integers(len(sample))]
    return words


def _nearest(points: np.ndarray, words: np.ndarray) -> np.ndarray:
    return np.argmax(points @ words.T - 0.5 * (words * words).sum(axis=1), axis=1)


def _normalised(descriptors: np.ndarray) -> np.ndarray:
    values = descriptors.astype(np.float32)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def match(
    database: Path,
    photographs: Sequence[Prepared],
    pairs: Sequence[Pair],
    work: Path,
    *,
    seed: int,
    advance: Callable[[int], None],
    error: float | None = None,
) -> None:
    """Match the pairs that the database lacks, and keep what one geometry explains.

    work: folder for the list of pairs. advance: called with the number of pairs done. error: as `compare`.
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
    """Number of verified matches by pair of indices into `photographs`; pairs without any are omitted."""
    from dofbench.scenes.colmap_binding import pycolmap

    with pycolmap.Database.open(database) as opened:
        ids = {image.name: image.image_id for image in opened.read_all_images()}
        keys, numbers = opened.read_two_view_geometry_num_inliers()
    index = {ids[photograph.file_name]: place for place, photograph in enumerate(photographs)}
    found = {}
    for key, number in zip(keys, numbers, strict=True):
        if number:
            first, second = sorted(index[image] for image in pycolmap.pair_id_to_image_pair(key))
            found[first, second] = int(number)
    return found
