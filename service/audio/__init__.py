"""Audio as bytes: recordings from anywhere, PCM of streams."""
