"""Verbs of the lab: parse, load, call one function, print."""
