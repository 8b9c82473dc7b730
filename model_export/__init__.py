"""Simulation, training, evaluation and ONNX export of the networks; torch lives only here."""

SAMPLE_RATE = 16000
"""Hertz, of all audio that is simulated and trained on"""
