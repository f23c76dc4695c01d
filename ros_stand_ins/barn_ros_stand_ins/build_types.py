"""Builds message types from their definitions, by the ROS generators that come as wheels.

The types are real ones, with type support in C, as a full installation has them. A
package takes some 5 s, a C++ compiler, and the headers of Python.
"""

import os
import subprocess
import sysconfig
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
    # Of all types that are installed, since definitions may use any of them.
    libraries = sorted(library.glob("lib*__rosidl_*.so"))
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
            f"-Wl,--as-needed,-soname,{target.name},-rpath,$ORIGIN:$ORIGIN/../../..:{library}:{folder}",
            *map(str, libraries),
        ]
        subprocess.run(command, check=True)
        libraries.append(target)
