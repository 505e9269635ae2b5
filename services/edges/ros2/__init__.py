"""The edge to ROS 2: its messages in and out, over Zenoh, as zenoh-plugin-ros2dds bridges them. An extra: ``ros2``."""
