"""Bridge to ROS 2 over Zenoh, with messages as zenoh-plugin-ros2dds carries them. It needs the extra ``ros2``."""
