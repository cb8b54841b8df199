"""Figures about maps, positions and lanes: what docs/maps.md says of them."""
