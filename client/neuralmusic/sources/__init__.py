"""Sources of a stream's audio: files, standard input, microphones."""
