"""Worker processes, and the service's pools of them."""
