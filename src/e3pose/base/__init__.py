"""Foundations: errors, quantities, clocks, files, locks, kernels, plug-ins."""
