"""The figures about real pictures: `python -m tests.camera_figures` measures and writes them."""
