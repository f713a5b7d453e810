"""The command line: parse, load, call one function, print."""

from e3pose.cli.app import main as main
