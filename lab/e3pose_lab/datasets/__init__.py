"""Readers of research data sets."""
