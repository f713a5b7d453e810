"""The camera node: frames in, 2D poses out."""
