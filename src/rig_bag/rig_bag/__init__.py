"""Bags of the rig: MCAP files in rosbag2's layout, written, read, described and played.

Nothing here needs a running graph except :mod:`rig_bag.recorder` and :mod:`rig_bag.player`.
"""

from rig_bag.errors import BagError
from rig_bag.reader import Bag, info, messages, read
from rig_bag.writer import BagWriter

__all__ = ["Bag", "BagError", "BagWriter", "info", "messages", "read"]
