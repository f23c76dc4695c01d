"""Message packages that the wheels lack, built for a test by the ROS generators that
come with them.

The types are real ones, with type support in C, as a full installation has them. Usage:
message_packages.py FOLDER PACKAGE...: FOLDER then belongs into PYTHONPATH and
LD_LIBRARY_PATH of what uses them. Takes some 3 s for each package, and a C compiler.
"""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
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

PREFIX = Path(sys.prefix)
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
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}


def generate(folder, package):
    """Write the definitions of a package, where an installation has them, and its
    sources.
    """
    share = folder / "share" / package
    package_folder = folder / package
    shared = [str(PREFIX / "share"), str(folder / "share")]
    interfaces = []
    for path in [
        definition for definition in DEFINITIONS if definition.startswith(f"{package}/")
    ]:
        _, kind, name = path.split("/")
        (share / kind).mkdir(parents=True, exist_ok=True)
        (share / kind / f"{name}.{kind}").write_text(
            DEFINITIONS[path].replace(", ", "\n") + "\n"
        )
        interfaces += TRANSLATE[kind](kind).translate(
            package, [f"{share}:{kind}/{name}.{kind}"], shared, package_folder
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
    """Generate and compile a package."""
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
            f"-Wl,-soname,{target.name},-rpath,{library}:{folder}",
            *map(str, libraries),
        ]
        subprocess.run(command, check=True)
        libraries.append(target)


if __name__ == "__main__":
    os.environ["AMENT_PREFIX_PATH"] = str(PREFIX)
    for named in sys.argv[2:]:
        build(Path(sys.argv[1]).resolve(), named)
