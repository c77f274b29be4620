"""Heading-sensitive error of a constantly rotating system: model, calibration, correction."""
