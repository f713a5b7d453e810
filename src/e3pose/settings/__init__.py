"""Settings: typed, validated once, the same for command line, site file and Python."""
