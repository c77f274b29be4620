"""From logs of a turntable to a calibration of its heading-sensitive error."""
