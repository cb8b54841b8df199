"""The figures about real pictures: `python -m makers.camera` measures and writes them."""
