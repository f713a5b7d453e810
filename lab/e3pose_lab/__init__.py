"""Measurement, reproduction and training of e3pose: needed at no site."""

__version__ = "0.1.0"
