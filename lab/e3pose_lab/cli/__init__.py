"""Verbs of the lab: parse, load, call one function, print."""

import e3pose.cli.app  # noqa: F401  # loads these verbs; one that is imported first would miss it
