"""Solutions as MCAP files that ROS and Foxglove can open, written whole or not at all."""
