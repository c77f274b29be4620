"""Programs that print tables, run by hand: `python benchmarks/x.py` or `python -m benchmarks.x`."""
