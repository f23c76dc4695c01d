"""Builds the message types of packages in source that a program imports.

    python -m barn_ros_stand_ins.missing_types FOLDER SHARE FILE...

FILES are the program's, SHARE is a folder of packages by name. What those define, the
files or their neighbors import, and Python does not find, is built in FOLDER, which then
belongs into PYTHONPATH and LD_LIBRARY_PATH.
"""

import importlib.util
import shutil
import sys
from pathlib import Path

KINDS = ("action", "msg", "srv")


def missing_packages(share, files):
    """Yield folders of packages whose types files import and Python does not find."""
    folders = {file.parent for file in files}
    neighbors = [file for folder in folders for file in folder.glob("*.py")]
    text = "\n".join(file.read_text("utf-8", "replace") for file in neighbors)
    for package in sorted(share.iterdir()):
        modules = [
            f"{package.name}.{kind}" for kind in KINDS if (package / kind).is_dir()
        ]
        is_imported = any(module in text for module in modules)
        # Types of a sourced workspace come first. A folder without modules has no origin.
        spec = importlib.util.find_spec(package.name)
        if is_imported and (spec is None or spec.origin is None):
            yield package


def main(folder, share, files):
    """Build the types of packages that files need, unless the folder has them."""
    for package in missing_packages(share, files):
        definitions = folder / "share" / package.name
        if not definitions.exists():
            for kind in KINDS:
                for path in package.glob(f"{kind}/*.{kind}"):
                    (definitions / kind).mkdir(parents=True, exist_ok=True)
                    shutil.copy(path, definitions / kind)
            # Only now: the generators take a second to import.
            builder = importlib.import_module("barn_ros_stand_ins.build_types")
            builder.build(folder, package.name)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]), [Path(word) for word in sys.argv[3:]])
