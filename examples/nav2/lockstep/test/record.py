"""Take what a robot observed from bags of trials, for test_navigator: `python record.py OUT BAG...`.

Each trial in OUT, little-endian: the number of its observations and of beams (int32), angle_min, angle_increment,
range_min, range_max (float32), the goal's x and y in odom (float64); then for each scan its stamp in ns (int64), the
odometry of that instant, x, y, yaw, forward speed and yaw rate (float64), and the ranges (float32). One beam in eight.
"""

import struct
import sys
from pathlib import Path

from barn_eval.results.bags.bagfile import BagFile
from barn_worlds.messages import decode

EVERY = 8  # of how many beams one is taken
READ = {"/odom": decode.odometry, "/scan": decode.scan, "/goal_pose": decode.pose}


def observations(path):
    """Yield the bytes of one trial."""
    readings = {topic: [] for topic in READ}
    for message in BagFile(Path(path)).messages(READ):
        readings[message.topic].append(READ[message.topic](message.data))
    odometry = {one.stamp_ns: one for one in readings["/odom"]}
    scans = [scan for scan in readings["/scan"] if scan.stamp_ns in odometry]
    first, goal = scans[0], readings["/goal_pose"][0]
    beams = len(first.ranges[::EVERY])
    yield struct.pack("<ii", len(scans), beams)
    yield struct.pack(
        "<4f",
        first.angle_min,
        first.angle_increment * EVERY,
        first.range_min,
        first.range_max,
    )
    yield struct.pack("<dd", goal.x, goal.y)
    for scan in scans:
        pose, velocity = odometry[scan.stamp_ns].pose, odometry[scan.stamp_ns].velocity
        yield struct.pack(
            "<q5d",
            scan.stamp_ns,
            pose.x,
            pose.y,
            pose.yaw,
            velocity.linear,
            velocity.angular,
        )
        yield scan.ranges[::EVERY].astype("<f4").tobytes()


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(
        b"".join(part for bag in sys.argv[2:] for part in observations(bag))
    )
