"""Where the vehicle points: at rest, and in flight."""
