"""Where the vehicle points: at rest now, in flight to come."""
