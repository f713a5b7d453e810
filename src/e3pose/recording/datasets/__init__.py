"""Data sets and detections in other formats, read as recordings."""
