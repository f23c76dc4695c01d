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

# As far as the suite and its examples use the types.
DEFINITIONS = Path(__file__).with_name("messages")


if __name__ == "__main__":
    folder = Path(sys.argv[1]).resolve()
    for package in sys.argv[2:]:
        # Those that make install builds have their definitions there.
        for definitions in (INSTALLED / package, DEFINITIONS / package):
            if definitions.is_dir():
                shutil.copytree(definitions, folder / "share" / package)
        build(folder, package)
