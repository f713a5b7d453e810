"""Recordings: what a rig's detectors saw, kept in a documented folder format."""

from e3pose.recording.record import Recording as Recording
from e3pose.recording.record import Truth as Truth
from e3pose.recording.record import ViewSeries as ViewSeries
