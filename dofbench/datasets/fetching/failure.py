"""Why a dataset couldn't be fetched, when the call was right."""

from __future__ import annotations


class FetchFailure(Exception):
    """A download or an archive that failed, in one line: the network, the server, or what it sent."""


class BadArchive(FetchFailure):
    """An archive that no further call could unpack."""
