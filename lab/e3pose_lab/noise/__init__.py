"""Noise of a detector, measured on recordings without labels."""
