"""A site: its configuration, and the programs that run on its machines."""
