"""How work is run on the processor: compiled kernels, threads, a stopwatch. Any other room may use it."""
