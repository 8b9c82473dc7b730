"""What the machine has: CPUs, memory."""
