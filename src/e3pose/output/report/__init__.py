"""The report page: 3D player, selection, energy."""

from e3pose.output.report.page import write_report

__all__ = ["write_report"]
