"""Simulation, training, evaluation and ONNX export of the networks; torch lives only here."""
