"""Plain numpy forms of the compiled kernels: what these are held against."""
