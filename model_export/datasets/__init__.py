"""Corpora on a user's disk, in the layout that they unpack to."""
