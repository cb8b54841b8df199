"""The parts of the paper's four simple line detectors (section `section:simple-line-detector`)."""
