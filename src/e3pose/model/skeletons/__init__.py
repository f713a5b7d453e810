"""Skeletons that come with the package, a TOML file each, and the names that they share."""
