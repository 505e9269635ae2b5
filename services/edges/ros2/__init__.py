"""Edge to ROS 2 over Zenoh, through zenoh-plugin-ros2dds or beside rmw_zenoh. It needs the extra ``ros2``."""
