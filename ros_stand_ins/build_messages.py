"""Builds message packages that have no wheel, by the ROS generators that come as wheels.

    python build_messages.py WHEELS PACKAGE...

writes a wheel of each package, from its definitions in messages/ beside this file, into
the folder WHEELS. The types are real ones, with type support in C, as a full
installation has them. It takes some 5 s for each package, a C compiler and the headers
of Python.
"""

import base64
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import rosidl_adapter
from rosidl_adapter.cli import (
    TranslateActionToIDL,
    TranslateMsgToIDL,
    TranslateSrvToIDL,
)
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_generator_type_description.cli import HashTypeDescription
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

# Beside the virtual environment where ROS 2 is installed for the whole system.
PREFIX = Path(rosidl_adapter.__file__).parents[4]
DEFINITIONS = Path(__file__).with_name("messages")
VERSION = "0.1.0"
USED = (
    "builtin_interfaces",
    "service_msgs",
    "unique_identifier_msgs",
    "action_msgs",
    "std_msgs",
    "geometry_msgs",
)
PARTS = (
    "generator_c",
    "typesupport_fastrtps_c",
    "typesupport_introspection_c",
    "typesupport_c",
    "generator_py",
)
TYPE_SUPPORTS = ("c", "fastrtps_c", "fastrtps_cpp", "introspection_c")
RUNTIME = (
    "rosidl_runtime_c",
    "rmw",
    "fastcdr",
    "rcutils",
    *(f"rosidl_typesupport_{support}" for support in TYPE_SUPPORTS),
)
TRANSLATE = {
    "action": TranslateActionToIDL,
    "msg": TranslateMsgToIDL,
    "srv": TranslateSrvToIDL,
}


def generate(folder, package):
    """Write the sources of a package whose definitions are in folder/share/package."""
    share = folder / "share" / package
    package_folder = folder / package
    shared = [str(PREFIX / "share"), str(folder / "share")]
    interfaces = []
    for path in sorted(share.glob("*/*")):
        kind = path.parent.name
        interfaces += TRANSLATE[kind](kind).translate(
            package, [f"{share}:{kind}/{path.name}"], shared, package_folder
        )
    hashes = HashTypeDescription("hash").generate_type_hashes(
        package, interfaces, shared, package_folder
    )
    both = ["rosidl_typesupport_introspection_c", "rosidl_typesupport_fastrtps_c"]
    GenerateC("c").generate(
        package, interfaces, shared, package_folder, type_description_files=hashes
    )
    GenerateFastRTPSCTypesupport("fast").generate(
        package, interfaces, shared, package_folder
    )
    # two generators give a file the same name
    GenerateIntrospectionCTypesupport("seen").generate(
        package, interfaces, shared, folder / "introspection" / package
    )
    GenerateCTypesupport("c", typesupport_implementations=both).generate(
        package, interfaces, shared, package_folder
    )
    python = GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"])
    python.generate(package, interfaces, shared, package_folder)


def build(folder, package):
    """Generate and compile a package whose definitions are in folder/share/package.

    Args:
        folder: Where it is built. It then belongs into PYTHONPATH and LD_LIBRARY_PATH.
        package: Name of the package.
    """
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)
    generate(folder, package)
    library = PREFIX / "lib"
    libraries = [
        library / f"lib{used}__rosidl_{part}.so" for used in USED for part in PARTS
    ]
    libraries += [library / f"lib{used}.so" for used in RUNTIME]
    headers = [
        folder,
        folder / "introspection",
        PREFIX / "include",
        *(PREFIX / "include").iterdir(),
    ]
    headers += [sysconfig.get_paths()["include"], np.get_include()]
    patterns = {
        "generator_c": f"{package}/*/detail/*.c",
        "typesupport_fastrtps_c": f"{package}/*/detail/*_c.cpp",
        "typesupport_introspection_c": f"introspection/{package}/*/detail/*.c",
        "typesupport_c": f"{package}/*/*__type_support.cpp",
        "generator_py": f"{package}/*/*_s.c",
    }
    targets = {
        folder / f"lib{package}__rosidl_{part}.so": pattern
        for part, pattern in patterns.items()
    }
    targets[folder / package / f"{package}_s__rosidl_typesupport_c.so"] = (
        f"{package}/_{package}_s.ep.*.c"
    )
    for target, pattern in targets.items():
        sources = sorted(map(str, folder.glob(pattern)))
        compiler = ["c++", "-std=c++17"] if sources[0].endswith("cpp") else ["cc"]
        command = [
            *compiler,
            "-shared",
            "-fPIC",
            "-O0",
            "-w",
            *(f"-I{header_folder}" for header_folder in headers),
            *sources,
        ]
        command += [
            "-o",
            str(target),
            f"-Wl,-soname,{target.name},-rpath,$ORIGIN:$ORIGIN/../../..:{library}:{folder}",
            *map(str, libraries),
        ]
        subprocess.run(command, check=True)
        libraries.append(target)


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
