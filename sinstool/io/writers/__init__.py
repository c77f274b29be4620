"""Solutions out: MCAP that any ROS or Foxglove user can open, whole or not at all."""
