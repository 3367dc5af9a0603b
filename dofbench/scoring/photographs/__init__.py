"""Scores of photographs whose lens nobody knows: what has to be known to predict one is fitted on half of it, and the
other half is scored."""

from __future__ import annotations
