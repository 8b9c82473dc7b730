"""Simulation, training, evaluation and ONNX export of the networks; torch lives only here."""

SAMPLE_RATE = 16000
"""Sample rate of all simulated audio and of all training, in hertz"""
