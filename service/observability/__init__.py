"""What the service counts, logs and traces."""
