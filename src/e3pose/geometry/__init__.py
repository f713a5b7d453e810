"""Cameras: where a world point lands in an image, and which ray a pixel looks along."""
