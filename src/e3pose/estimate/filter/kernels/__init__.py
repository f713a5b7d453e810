"""The estimators, compiled with numba."""
