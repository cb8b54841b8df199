"""Pictures: cameras, their calibration, the detectors on them, rendered motorways, videos."""
