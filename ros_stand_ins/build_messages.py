"""Writes wheels of message packages that have none.

    python build_messages.py WHEELS PACKAGE...

writes a wheel of each package, from its definitions in messages/ beside this file, into
the folder WHEELS. barn_ros_stand_ins.build_types says what that takes.
"""

import base64
import hashlib
import shutil
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

from barn_ros_stand_ins.build_types import build

DEFINITIONS = Path(__file__).with_name("messages")
VERSION = "0.1.0"


def write_wheel(folder, package, wheels):
    """Write a wheel of a package that was built in a folder."""
    interpreter = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    stem = f"barn_{package}-{VERSION}"
    tag = f"{interpreter}-{interpreter}-{platform}"
    members = {}
    members[f"{package}/__init__.py"] = b""
    for path in sorted((folder / package).rglob("*")):
        if path.suffix in (".py", ".so"):
            members[f"{path.relative_to(folder)}"] = path.read_bytes()
    # The loader looks for libraries and ament for its index below the prefix.
    for path in sorted(folder.glob(f"lib{package}__*.so")):
        members[f"{stem}.data/data/lib/{path.name}"] = path.read_bytes()
    for path in sorted((folder / "share" / package).glob("*/*")):
        name = path.relative_to(folder)
        members[f"{stem}.data/data/{name}"] = path.read_bytes()
    index = "share/ament_index/resource_index/packages"
    members[f"{stem}.data/data/{index}/{package}"] = b""
    members[f"{stem}.dist-info/METADATA"] = (
        f"Metadata-Version: 2.1\nName: barn-{package.replace('_', '-')}\n"
        f"Version: {VERSION}\nSummary: The types of {package}, built from their"
        " definitions\n"
    ).encode()
    members[f"{stem}.dist-info/WHEEL"] = (
        "Wheel-Version: 1.0\nGenerator: build_messages.py\nRoot-Is-Purelib: false\n"
        f"Tag: {tag}\n"
    ).encode()

    record = []
    for name, content in members.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest())
        record.append(f"{name},sha256={digest.rstrip(b'=').decode()},{len(content)}")
    record.append(f"{stem}.dist-info/RECORD,,")
    members[f"{stem}.dist-info/RECORD"] = ("\n".join(record) + "\n").encode()
    wheels.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(
        wheels / f"{stem}-{tag}.whl", "w", zipfile.ZIP_DEFLATED
    ) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def main(wheels, packages):
    """Build packages in a temporary folder, and write their wheels."""
    for package in packages:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name).resolve()
            shutil.copytree(DEFINITIONS / package, folder / "share" / package)
            build(folder, package)
            write_wheel(folder, package, wheels)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
