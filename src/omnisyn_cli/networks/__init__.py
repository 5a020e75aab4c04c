"""The learned parts, in torch: building blocks, the depth network and its export to ONNX."""
