"""Many logs, on local processes or a Dask cluster, through one interface (see `jobs`)."""
