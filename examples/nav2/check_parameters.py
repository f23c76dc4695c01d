"""Check parameter files against source code.

    python3 check_parameters.py NAVIGATION2 [PLUGIN_TREE ...] [MINE.yaml ...] [EXPECTED.txt]

Nav2 ignores parameters that it does not know, so a misspelled one goes unnoticed; and it
ends at once where a value has another type than its default. The name of every parameter
must occur in quotes in the source of the package that reads it: for a parameter of a node
itself, not as one of a plugin. Its value must have the type of a default there. Every
plugin in a list must have a section, and one of the trees must export its class. Without
files, those in `params` are checked. The script prints each failure and how many parameters were
checked, and exits with 1 if there is a failure. EXPECTED.txt has a line for each
failure that is expected; with it, the script also exits with 1 if one of them is
missing.
"""

import re
import sys
from functools import cache
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
YAML_SUFFIXES = (".yaml", ".yml")
SOURCE_SUFFIXES = ("cpp", "hpp", "h", "py")
# Packages that read the parameters of a node. By default a node NAME or NAME_server is
# in the package nav2_NAME.
PACKAGES = {
    "controller_server": ["nav2_controller", "nav2_dwb_controller"],
    "local_costmap": ["nav2_costmap_2d"],
    "global_costmap": ["nav2_costmap_2d"],
    "behavior_server": ["nav2_behaviors"],
    "bt_navigator": ["nav2_bt_navigator", "nav2_behavior_tree"],
}
# A name, in a call that declares it or reads it with a default, and the default.
DECLARATION = r"""(?:declare\w*|getParam|getParentParam|searchAndGetParam)(?:<[^>]*>)?\s*\(
    [^;]*?["'](?:[\w.]*\.)?%s["']\s*,\s*(?P<default>[^;]*?)\)\s*;"""
# Type by the beginning of a default in C++.
DEFAULT_TYPES = {
    r"true\b|false\b|rclcpp::\w*(?:::)?PARAMETER_BOOL\b": "bool",
    r"-?\d+(?![\d.eEf])|rclcpp::\w*(?:::)?PARAMETER_INTEGER\b": "int",
    r"-?(?:\d+\.\d*|\.\d+|\d+(?=f))|rclcpp::\w*(?:::)?PARAMETER_DOUBLE\b": "double",
    r"\"|std::string\b|rclcpp::\w*(?:::)?PARAMETER_STRING\b": "string",
    r"std::vector<std::string>|rclcpp::\w*(?:::)?PARAMETER_STRING_ARRAY\b": "list",
}
YAML_TYPES = {bool: "bool", int: "int", float: "double", str: "string", list: "list"}
# Parameters that list the names of sections below the same node.
SECTION_LISTS = ("plugins", "filters", "navigators")
# Parameters of any node: of rclcpp and of Nav2's lifecycle nodes.
COMMON = {
    "use_sim_time",
    "start_type_description_service",
    "bond_heartbeat_period",
    "introspection_mode",
    "service_introspection_mode",
}
# Class of a critic by its short name, for the controllers that have critics.
CRITICS = {
    "nav2_mppi_controller::MPPIController": "mppi::critics::{}",
    "dwb_core::DWBLocalPlanner": "dwb_critics::{}Critic",
}


def main(arguments):
    """Print all failures and return the exit code."""
    lists = [argument for argument in arguments if argument.endswith(".txt")]
    paths = [Path(argument) for argument in arguments if argument not in lists]
    files = [path for path in paths if path.suffix in YAML_SUFFIXES]
    trees = tuple(path for path in paths if path.suffix not in YAML_SUFFIXES)
    missing = [
        str(path) for path in (*files, *trees, *lists) if not Path(path).exists()
    ]
    if missing or not any((tree / "nav2_controller").is_dir() for tree in trees):
        usage = "check_parameters.py NAVIGATION2 [PLUGIN_TREE ...] [MINE.yaml ...]"
        print(f"usage: {usage}", *missing, file=sys.stderr)
        return 2

    failures = []
    nodes = []
    for path in files or sorted((HERE / "params").glob("*.yaml")):
        try:
            content = yaml.safe_load(path.read_text("utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError, IsADirectoryError) as error:
            reason = " ".join(str(error).split())
            failures.append(f"{path}: cannot be read: {reason}")
            continue
        nodes += [(path, *node) for node in find_nodes(content)]

    problems = list(check_nodes(nodes, trees))
    failures += [problem for problem in problems if problem]
    print(*failures, sep="\n", end="\n" if failures else "")
    print(f"{len(problems)} parameters checked, {len(failures)} wrong")
    expected = set()
    for path in lists:
        expected |= set(Path(path).read_text("utf-8").splitlines())
    surprises = expected.symmetric_difference(failures)
    if expected:
        for line in sorted(surprises):
            print(f"not as expected: {line}")
    return 1 if surprises else 0


def check_nodes(nodes, trees):
    """Yield a text for each parameter, what is wrong with it or an empty one.

    Args:
        nodes: File, name and parameters of each node.
        trees: Source trees.
    """
    # A node may read several files, one over the other.
    sections = {}
    for _, node, parameters in nodes:
        names = {key for key, value in parameters.items() if isinstance(value, dict)}
        sections[node] = sections.get(node, set()) | names
    for path, node, parameters in nodes:
        folders = package_folders(node, trees) or trees
        for name, problem in check(parameters, folders, trees, sections[node]):
            yield f"{path.name}: {node}: {name}{problem}" if problem else ""


def find_nodes(content):
    """Yield each node of a parameter file with its parameters.

    Costmaps stand in a namespace of their own name, so nodes can be nested.
    """
    if not isinstance(content, dict):
        return
    for name, section in content.items():
        if isinstance(section, dict) and isinstance(
            section.get("ros__parameters"), dict
        ):
            yield name, section["ros__parameters"]
        else:
            yield from find_nodes(section)


def package_folders(node, trees):
    """Return the folders of the packages that read the parameters of a node.

    Args:
        node: Name of the node.
        trees: Source trees.
    """
    packages = PACKAGES.get(node, [f"nav2_{node.removesuffix('_server')}"])
    folders = [tree / package for tree in trees for package in packages]
    return tuple(folder for folder in folders if folder.is_dir())


def check(parameters, folders, trees, sections, prefix=""):
    """Yield the dotted name of each parameter and what is wrong with it, if anything.

    Args:
        parameters: Nested parameters of a node.
        folders: Source folders that may read them.
        trees: Source trees, whose plugins bring folders of their own.
        sections: Names of the node's sections.
        prefix: Dotted name of the section.
    """
    plugins = exported_classes(trees)
    plugin = parameters.get("plugin")
    if isinstance(plugin, str):
        folders = plugins.get(plugin, ())
        if not folders:
            problem = f"no plugin {plugin} in these trees, what it reads is not checked"
            yield f"{prefix}plugin", f": {problem}"
            return
        yield f"{prefix}plugin", ""

    for key, value in parameters.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from check(value, folders, trees, sections, f"{name}.")
        elif key == "critics" and plugin in CRITICS:
            classes = {critic: CRITICS[plugin].format(critic) for critic in value}
            missing = [critic for critic in value if classes[critic] not in plugins]
            yield name, f": no plugin {', '.join(missing)}" if missing else ""
        elif key != "plugin" and key not in COMMON:
            is_of_node = not prefix and plugin is None
            problem = find_problem(str(key), value, folders, is_of_node=is_of_node)
            if not problem and is_of_node and str(key).endswith(SECTION_LISTS):
                missing = sorted(set(value) - sections)
                if missing:
                    problem = f" names {', '.join(missing)}, which has no section"
            yield name, problem


def find_problem(key, value, folders, *, is_of_node):
    """Return what is wrong with a parameter, or an empty text.

    Args:
        key: Name of the parameter in its section.
        value: Its value.
        folders: Source folders that may read it.
        is_of_node: Whether it stands in no section, but at the node itself.
    """
    readers = ", ".join(folder.name for folder in folders)
    if not any(reads(folder, key) for folder in folders):
        return f" is not read by {readers}"
    if any(refuses(folder, key) for folder in folders):
        return f" is refused by {readers}"
    if is_of_node and not any(is_read_by_node(folder, key) for folder in folders):
        return f" is read by {readers} below a plugin, not here"
    types = set()
    for folder in folders:
        types |= default_types(folder, key)
    # Defaults that are no literals leave the type open.
    value_type = YAML_TYPES.get(type(value))
    if key.endswith(SECTION_LISTS):
        types = {"list"}
    if not types or value_type in types:
        return ""
    names = " or ".join(sorted(types))
    return f" is {value!r}, of type {value_type}; {readers} declares {names}"


def reads(folder, key):
    """Return whether the source of a folder has a parameter's name in quotes.

    Args:
        folder: Package or tree.
        key: Name of the parameter, of which only the part after the last dot counts.
    """
    last_part = re.escape(key.rpartition(".")[2])
    return re.search(rf"""["'](?:[\w.]*\.)?{last_part}["']""", source(folder))


def refuses(folder, key):
    """Return whether a folder's source throws if a parameter is set."""
    pattern = rf"""has_parameter\("{re.escape(key)}"\)\)\s*\{{\s*throw"""
    return re.search(pattern, source(folder))


def is_read_by_node(folder, key):
    """Return whether a folder's source has a name in quotes that is added to no other."""
    name = re.escape(key)
    return re.search(rf"""(?<![+])[^+"'\s]\s*["']{name}["']""", source(folder))


@cache
def default_types(folder, key):
    """Return the types of the literal defaults of a parameter in a folder's source."""
    types = set()
    pattern = DECLARATION % re.escape(key.rpartition(".")[2])
    for match in re.finditer(pattern, source(folder), re.VERBOSE):
        default = match["default"].removeprefix("rclcpp::ParameterValue(").lstrip()
        found = [
            kind for start, kind in DEFAULT_TYPES.items() if re.match(start, default)
        ]
        # An open default could have any type.
        types.update(found or YAML_TYPES.values())
    return types


@cache
def source(folder):
    """Return all code of a package or a tree, without its tests."""
    texts = []
    for suffix in SOURCE_SUFFIXES:
        for file in folder.rglob(f"*.{suffix}"):
            if "test" not in file.parts:
                texts.append(file.read_text("utf-8", "replace"))
    return "\n".join(texts)


@cache
def exported_classes(trees):
    """Return the folder of each class that a plugin description exports, as a tuple."""
    folders = {}
    for tree in trees:
        for file in tree.rglob("*.xml"):
            # A tree is one package or holds many.
            folder = tree / file.relative_to(tree).parts[0]
            if (tree / "package.xml").is_file():
                folder = tree
            text = file.read_text("utf-8", "replace")
            pattern = r'<class\s[^>]*?\b(?:type|name)="([^"]+)"'
            for name in re.findall(pattern, text, re.DOTALL):
                folders[name] = (folder,)
    return folders


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
