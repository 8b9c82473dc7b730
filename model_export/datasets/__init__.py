"""Corpora that a user has on disk, in the layout in which they unpack."""
