"""What the paper's four simple line detectors are made of."""
