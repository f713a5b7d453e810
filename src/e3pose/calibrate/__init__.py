"""Calibrating cameras: boards, lenses, places by boards or people, the floor, and the error."""
