"""Where a stream's audio comes from: files, standard input, microphones."""
