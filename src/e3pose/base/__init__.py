"""What everything stands on: errors, quantities, clocks, files, locks, kernels, plug-ins."""
