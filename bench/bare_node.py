"""The least that a node in Python is: it says that it is there, and waits for its end. Its start is a baseline."""

import contextlib

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("bare", namespace="/rig")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(String, "bare", latched).publish(String(data="ready"))
with contextlib.suppress(KeyboardInterrupt):
    rclpy.spin(node)
