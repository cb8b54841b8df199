"""Pictures: cameras, their calibration, the detectors on them, simulated ones, videos."""
