"""Power meters of this machine."""
