"""Skeletons drawn over video frames, as a movie or as images."""

from e3pose.output.report.overlay.draw import draw_poses as draw_poses
from e3pose.output.report.overlay.draw import reproject as reproject
from e3pose.output.report.overlay.draw import track_color as track_color
from e3pose.output.report.overlay.movie import write_movie as write_movie
from e3pose.output.report.overlay.panels import overlay_images as overlay_images
