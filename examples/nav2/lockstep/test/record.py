"""Take a robot's observations from bags, for test_navigator.

`python record.py OUT BAG...`.

For each trial, OUT holds in little-endian order:

- number of observations and of beams (int32);
- angle_min, angle_increment, range_min, range_max (float32);
- x and y of the goal in odom (float64);
- for each scan its stamp in ns (int64), the odometry at that instant (x, y, yaw,
  forward
  speed and yaw rate, float64), and the ranges (float32) of one beam in eight.
"""

import struct
import sys
from pathlib import Path

from barn_eval.results.bags.bagfile import BagFile
from barn_worlds.messages import decode

BEAM_STRIDE = 8
DECODERS = {"/odom": decode.odometry, "/scan": decode.scan, "/goal_pose": decode.pose}


def observations(path):
    """Yield the bytes of one trial."""
    readings = {topic: [] for topic in DECODERS}
    for message in BagFile(Path(path)).messages(DECODERS):
        readings[message.topic].append(DECODERS[message.topic](message.data))
    odometry_by_stamp = {reading.stamp_ns: reading for reading in readings["/odom"]}
    scans = [scan for scan in readings["/scan"] if scan.stamp_ns in odometry_by_stamp]

    first = scans[0]
    yield struct.pack("<ii", len(scans), len(first.ranges[::BEAM_STRIDE]))
    yield struct.pack(
        "<4f",
        first.angle_min,
        first.angle_increment * BEAM_STRIDE,
        first.range_min,
        first.range_max,
    )
    goal = readings["/goal_pose"][0]
    yield struct.pack("<dd", goal.x, goal.y)

    for scan in scans:
        odometry = odometry_by_stamp[scan.stamp_ns]
        pose = odometry.pose
        velocity = odometry.velocity
        yield struct.pack(
            "<q5d",
            scan.stamp_ns,
            pose.x,
            pose.y,
            pose.yaw,
            velocity.linear,
            velocity.angular,
        )
        yield scan.ranges[::BEAM_STRIDE].astype("<f4").tobytes()


if __name__ == "__main__":
    output, *bags = sys.argv[1:]
    Path(output).write_bytes(
        b"".join(part for bag in bags for part in observations(bag))
    )
