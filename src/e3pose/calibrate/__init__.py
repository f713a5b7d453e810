"""Camera calibration: intrinsics, extrinsics, alignment with the floor, expected error."""
