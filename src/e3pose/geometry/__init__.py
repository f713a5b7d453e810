"""Cameras: projection, distortion, rays, rigs, rotations."""
