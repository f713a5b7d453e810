"""Recordings: what a rig's detectors saw, kept in a documented folder format."""

from e3pose.recording.folder import load_recording as load_recording
from e3pose.recording.folder import read_series as read_series
from e3pose.recording.folder import save_recording as save_recording
from e3pose.recording.json_lines import decode_view as decode_view
from e3pose.recording.json_lines import encode_view as encode_view
from e3pose.recording.processor import ProcessorTime as ProcessorTime
from e3pose.recording.record import Recording as Recording
from e3pose.recording.record import Truth as Truth
from e3pose.recording.record import ViewSeries as ViewSeries
