"""Which photographs to compare: all pairs, neighbours in order, or those that look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dofbench.scenes.reconstruction.reconstruct_options import Matching

Pair = tuple[int, int]

# Up to here all pairs are compared: 3 160 of them.
EXHAUSTIVE = 80
# How many of the most similar photographs each one is compared with; and in a sequence, where neighbours are
# compared anyway, how many more to close loops.
LOOK_ALIKES, LOOPS = 20, 4
# In a sequence: how many neighbours each photograph is compared with, and which farther ones.
_OVERLAP, _FARTHER = 10, (16, 32, 64)

_WORDS, _SAMPLE, _ROUNDS = 64, 40_000, 12


def choose(matching: Matching, count: int, video: bool) -> Matching:
    """What `auto` means for so many photographs."""
    if matching != "auto":
        return matching
    if count <= EXHAUSTIVE:
        return "exhaustive"
    return "sequential" if video else "retrieval"


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
    """(N, D) float32 of unit length: each photograph's features as one vector, by the photographs' own vocabulary.

    VLAD (Jegou et al. 2010): what remains of the descriptors after the nearest of 64 words is taken away, summed by
    word; each word's sum scaled to one length (Arandjelovic and Zisserman 2013), then the whole. descriptors: (n, 128)
    a photograph. The words are found by k-means on a sample of all.
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
    """k-means by Lloyd's rounds from a random choice; a word that lost all its members begins anew at a random one."""
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
