"""A ``ros2`` command for machines that have rclpy but no ros2cli.

The syntax and the output are those of ros2cli for ROS 2 Jazzy, for the commands that :mod:`ros2_fallback.cli` lists.
Packages, executables and interfaces are found by the ament index.
"""
