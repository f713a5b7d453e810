"""The page that shows a run: skeletons to turn and play, the selection, the energy."""

from e3pose.report.page import write_report

__all__ = ["write_report"]
