"""`python -m e3pose`."""

from e3pose.cli import main

main()
