"""A bundle fitted to recordings of one room and array."""
