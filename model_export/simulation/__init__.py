"""Rooms, arrays, noises, and the scenes that are made of them."""
