"""Offline evaluation: replay a recording, score it against the truth, compare policies."""
