"""Meters: what this machine can say of its own power."""
