"""Trained networks at work: ONNX Runtime and numpy only."""
