"""Side-by-side comparison of coning algorithms: arrays in, numbers and figures out."""
