"""Computation on arrays: coning < height < strapdown < alignment < ins_gnss; hse apart."""
