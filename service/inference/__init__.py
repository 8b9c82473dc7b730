"""Model bundles, onnxruntime, and localizers that turn windows of audio into directions."""
