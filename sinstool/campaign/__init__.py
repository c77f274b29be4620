"""Many logs: local processes or a Dask cluster, through one seam (see `jobs`)."""
