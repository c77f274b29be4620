"""From a log with rests to the noise of its sensors."""
