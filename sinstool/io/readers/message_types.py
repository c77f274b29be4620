"""Message types that are read, by their ROS 2 names and their use."""

from __future__ import annotations

IMU_TYPE = "sensor_msgs/msg/Imu"
FIX_TYPE = "sensor_msgs/msg/NavSatFix"
# From gpsd and others, by its ROS 2 and its ROS 1 package: a fix with a velocity
GPS_FIX_TYPES = ("gps_msgs/msg/GPSFix", "gps_common/msg/GPSFix")
FIX_TYPES = (FIX_TYPE, *GPS_FIX_TYPES)
PRESSURE_TYPE = "sensor_msgs/msg/FluidPressure"
MAGNETIC_TYPE = "sensor_msgs/msg/MagneticField"
JOINT_TYPE = "sensor_msgs/msg/JointState"
VELOCITY_TYPES = (
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
HEIGHT_TYPES = ("geometry_msgs/msg/PointStamped", "std_msgs/msg/Float64")
# All that a run may choose by itself
SENSOR_TYPES = (
    IMU_TYPE,
    *FIX_TYPES,
    *VELOCITY_TYPES,
    PRESSURE_TYPE,
    MAGNETIC_TYPE,
    JOINT_TYPE,
)
