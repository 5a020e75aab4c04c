"""How work is run: compiled kernels, threads, and trained networks by ONNX Runtime (numpy only)."""
