"""Files that detectors write, read as recordings."""
