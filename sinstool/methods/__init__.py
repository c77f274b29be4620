"""Arrays in, arrays out: coning < height < strapdown < alignment < ins_gnss; hse apart."""
