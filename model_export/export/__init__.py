"""Export of a trained run to a bundle: ONNX graphs, parity, manifest."""
