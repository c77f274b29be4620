"""Solutions as files of other programs: tables, trajectories, tracks on a map."""
