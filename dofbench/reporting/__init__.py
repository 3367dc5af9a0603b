"""Leaderboards, curves and comparison pictures of a folder of results."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # importing this package must be fast, because the command line imports it for its help
    from dofbench.reporting.report_files import Written
    from dofbench.reporting.report_options import Report

__all__ = ["report"]


def report(settings: Report) -> Written:
    """Read every result below `settings.results` and write the report; see `dofbench.reporting.report_files`."""
    from dofbench.reporting.report_files import write_report

    return write_report(settings)
