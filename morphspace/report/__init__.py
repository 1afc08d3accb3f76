"""The build report: one self-contained page that shows what a model has learnt and says where it is off."""

from morphspace.report.advice import Advice, Case, advice_for
from morphspace.report.figures import FrameFigures, SheetFrame, measure_frames
from morphspace.report.page import report_page, write_report

__all__ = [
    "Advice",
    "Case",
    "FrameFigures",
    "SheetFrame",
    "advice_for",
    "measure_frames",
    "report_page",
    "write_report",
]
