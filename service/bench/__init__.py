"""``neuralmusic bench``: what a window and a stream cost on this machine."""
