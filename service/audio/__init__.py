"""Audio as bytes: files that strangers made, PCM of streams."""
