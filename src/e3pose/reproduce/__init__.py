"""Redo the tables and figures of the paper with this system, beside the paper's own figures."""
