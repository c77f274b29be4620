"""The contents of a log and its anomalies."""
