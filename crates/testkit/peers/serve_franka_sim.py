"""Starts BarisYazici's franka-sim (PyPI) on an address of its own, every check of the commands enforced.

    python serve_franka_sim.py ADDRESS MJCF
"""

import logging
import os
import sys

address, mjcf = sys.argv[1:]
os.environ["FR3_MJCF"] = mjcf
logging.basicConfig(level=logging.WARNING, stream=sys.stderr)

from franka_sim import FrankaSimServer  # noqa: E402

server = FrankaSimServer(
    host=address,
    physics="mujoco",
    enable_gripper=False,
    enforce_comm_constraints=True,
    enforce_motion_limits=True,
)
server.start()
