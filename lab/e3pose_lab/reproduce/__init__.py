"""Reproduce the tables and figures of the paper beside the paper's own numbers."""
