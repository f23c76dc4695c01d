"""Message packages that the wheels lack, built for a test.

Usage: message_packages.py FOLDER PACKAGE...: FOLDER then belongs into PYTHONPATH and
LD_LIBRARY_PATH of what uses them.
"""

import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "ros_stand_ins"))

from barn_ros_stand_ins.build_types import build
from build_messages import DEFINITIONS as INSTALLED

# The types' definitions, as far as the suite and its examples use them, by package,
# kind and name.
DEFINITIONS = {
    "nav2_msgs/action/NavigateToPose": "geometry_msgs/PoseStamped pose, string behavior_tree, ---, uint16 error_code, "
    "---, float32 distance_remaining",
    "nav2_msgs/srv/ManageLifecycleNodes": "uint8 STARTUP = 0, uint8 PAUSE = 1, uint8 RESUME = 2, uint8 RESET = 3, "
    "uint8 SHUTDOWN = 4, uint8 command, ---, bool success",
    "nav2_msgs/msg/CostmapMetaData": "builtin_interfaces/Time map_load_time, builtin_interfaces/Time update_time, "
    "string layer, float32 resolution, uint32 size_x, uint32 size_y, geometry_msgs/Pose origin",
    "nav2_msgs/msg/Costmap": "std_msgs/Header header, CostmapMetaData metadata, uint8[] data",
}


if __name__ == "__main__":
    for package in sys.argv[2:]:
        folder = Path(sys.argv[1]).resolve()
        # Those that make install builds have their definitions there.
        if (INSTALLED / package).is_dir():
            shutil.copytree(INSTALLED / package, folder / "share" / package)
        for path, text in DEFINITIONS.items():
            file = folder / "share" / f"{path}.{path.split('/')[1]}"
            if path.startswith(f"{package}/"):
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text.replace(", ", "\n") + "\n")
        build(folder, package)
