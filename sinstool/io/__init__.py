"""Reading and writing of logs. Only this package converts axes, units and quaternions."""
