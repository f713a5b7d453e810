"""What the process runs on: clocks, compiled kernels, worker processes, plug-ins, thread names."""
