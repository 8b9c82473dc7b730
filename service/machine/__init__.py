"""The machine's CPUs and memory."""
