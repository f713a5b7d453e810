"""Comparisons of policies over recordings."""
