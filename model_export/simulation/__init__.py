"""Rooms, arrays, noises, and scenes made of them."""
