"""The data plane compiled with numba; imported only where `backend="numba"` is asked for."""
