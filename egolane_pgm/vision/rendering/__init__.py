"""Draws simulated motorways as pictures."""
