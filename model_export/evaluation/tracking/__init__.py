"""Scores of tracked streams, simulated and real."""
