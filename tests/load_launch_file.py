"""Load a launch file as a Python of the system does, and print what it declares.

python -I -S load_launch_file.py PREFIX FILE [NAME:=VALUE ...]

Python is started without site-packages, so everything but the standard library is
missing. PREFIX/python holds the few other modules that may be imported: PyYAML, which
launch needs itself, and the packages of the workspace. launch, launch_ros and
ament_index_python are stood in for by classes that keep what they are given, since they
come with a full ROS 2 installation only. `test_system_ros.py` uses the real ones.
"""

import importlib.util
import json
import sys
import types
from pathlib import Path

PREFIX = Path(sys.argv[1])
STOOD_IN = ("launch", "launch_ros", "ament_index_python")


class Entity:
    """Keeps what it was constructed with."""

    def __init__(self, *values, **named):
        self.values = values
        self.__dict__.update(named)


class LaunchConfiguration(Entity):
    def perform(self, context):
        return context[self.values[0]]


class Module(types.ModuleType):
    """A module that has every class."""

    __path__ = ()

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        if name == "LaunchConfiguration":
            return LaunchConfiguration
        if name.startswith("get_package"):
            end = "share" if name == "get_package_share_directory" else ""
            return lambda package: str(PREFIX / end / (package if end else ""))
        return type(name, (Entity,), {})


class Finder:
    """Finds the modules that are stood in for."""

    @staticmethod
    def find_spec(name, _path=None, _target=None):
        if name.partition(".")[0] not in STOOD_IN:
            return None
        return importlib.util.spec_from_loader(name, Finder)

    @staticmethod
    def create_module(spec):
        return Module(spec.name)

    @staticmethod
    def exec_module(_module):
        pass


def entities_of(file):
    """Return what a launch file describes."""
    spec = importlib.util.spec_from_file_location("launch_file", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description().values[0]


def included_file(include):
    """Return the path of a launch file that another one includes."""
    package, *names = include.values[0].values[0].values[0]
    return PREFIX.joinpath("share", package.values[0], *names)


def visit(entities, context, declared, made):
    """Declare arguments and make nodes, as launch does.

    Args:
        entities: What a launch file describes.
        context: Values of arguments, which this changes.
        declared: Meanings of arguments, to which this adds.
        made: Nodes, to which this adds.
    """
    for entity in entities:
        kind = type(entity).__name__
        if kind == "DeclareLaunchArgument":
            (name,) = entity.values
            declared[name] = entity.description
            context.setdefault(name, entity.default_value)
        elif kind == "OpaqueFunction":
            visit(entity.function(context), context, declared, made)
        elif kind == "SetLaunchConfiguration":
            name, context[name] = entity.values
        elif kind == "GroupAction":
            visit(entity.values[0], dict(context), declared, made)
        elif kind == "IncludeLaunchDescription":
            context |= entity.launch_arguments
            visit(entities_of(included_file(entity)), context, declared, made)
        elif kind == "Node":
            parameters = types_of(entity)
            made.append({"executable": entity.executable, "parameters": parameters})


def main(file, *arguments):
    sys.meta_path.insert(0, Finder)
    sys.path.append(str(PREFIX / "python"))
    context = dict(argument.split(":=") for argument in arguments)
    declared = {}
    made = []
    visit(entities_of(file), context, declared, made)
    used = {name.partition(".")[0] for name in sys.modules}
    result = {"arguments": declared, "nodes": made, "values": context}
    print(json.dumps(result | {"modules": sorted(used)}, default=str))


def types_of(node):
    """Return the type that each parameter of a node has been given."""
    types_by_name = {}
    for parameters in node.parameters:
        if isinstance(parameters, dict):
            for name, value in parameters.items():
                types_by_name[name] = str(value.value_type)
    return types_by_name


main(*sys.argv[2:])
