"""The compiled parts of selecting cameras."""
