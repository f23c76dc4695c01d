"""Check parameter files against source: `python3 check_parameters.py NAVIGATION2 [PLUGIN_TREE ...] [MINE.yaml ...]`.

Nav2 ignores parameters that it does not know, so that a misspelt one goes unnoticed. For every parameter, the name has
to occur as a quoted name in the source of the package that reads it; for every plugin, one of the trees has to export
its class. Without files, those in `params` are checked. Prints each that fails, and how many were checked; exits with 1
if there are any.
"""

import re
import sys
from functools import cache
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
# where the parameters of a node are read, if not in the package nav2_NAME of a node NAME or NAME_server
SOURCES = {
    "controller_server": ["nav2_controller", "nav2_dwb_controller"],
    "local_costmap": ["nav2_costmap_2d"],
    "global_costmap": ["nav2_costmap_2d"],
    "behavior_server": ["nav2_behaviors"],
    "bt_navigator": ["nav2_bt_navigator", "nav2_behavior_tree"],
}
# what any node takes: of rclcpp, and of Nav2's lifecycle nodes
COMMON = {"use_sim_time", "start_type_description_service", "bond_heartbeat_period"}
# class of a critic by its short name, for the controllers that have critics
CRITICS = {
    "nav2_mppi_controller::MPPIController": "mppi::critics::{}",
    "dwb_core::DWBLocalPlanner": "dwb_critics::{}Critic",
}


def main(arguments):
    """Print what no package knows and return how the check went."""
    files = [Path(one) for one in arguments if one.endswith((".yaml", ".yml"))]
    trees = tuple(Path(one) for one in arguments if not one.endswith((".yaml", ".yml")))
    missing = [str(one) for one in (*files, *trees) if not one.exists()]
    if missing or not any((tree / "nav2_controller").is_dir() for tree in trees):
        print(
            "usage: check_parameters.py NAVIGATION2 [PLUGIN_TREE ...] [MINE.yaml ...]",
            *missing,
            file=sys.stderr,
        )
        return 2
    checked = 0
    unknown = []
    for path in files or sorted((HERE / "params").glob("*.yaml")):
        try:
            found = list(nodes(yaml.safe_load(path.read_text("utf-8"))))
        except (yaml.YAMLError, UnicodeDecodeError, IsADirectoryError) as error:
            found = (
                unknown.append(
                    f"{path}: cannot be read: {' '.join(str(error).split())}"
                )
                or []
            )
        for node, values in found:
            named = SOURCES.get(node, [f"nav2_{node.removesuffix('_server')}"])
            places = tuple(
                tree / one for tree in trees for one in named if (tree / one).is_dir()
            )
            for name, problem in problems(values, places or trees, trees):
                checked += 1
                unknown += [f"{path.name}: {node}: {name}{problem}"] if problem else []
    print(
        "\n".join([*unknown, f"{checked} parameters checked, {len(unknown)} unknown"])
    )
    return 1 if unknown else 0


def nodes(content):
    """Yield each node of a parameter file with its parameters; costmaps stand in a namespace of their own name."""
    for name, about in content.items() if isinstance(content, dict) else ():
        if isinstance(about, dict) and isinstance(about.get("ros__parameters"), dict):
            yield name, about["ros__parameters"]
        else:
            yield from nodes(about)


def problems(values, places, trees, prefix=""):
    """Yield (dotted name, what is wrong with it, if anything) of each parameter that is read in these places."""
    plugin = values.get("plugin")
    if isinstance(plugin, str):
        places = exported(trees).get(plugin, ())
        yield (
            f"{prefix}plugin",
            ""
            if places
            else f": no plugin {plugin} in these trees, what it reads is not checked",
        )
        if not places:
            return
    for key, value in values.items():
        if isinstance(value, dict):
            yield from problems(value, places, trees, f"{prefix}{key}.")
        elif key == "critics" and plugin in CRITICS:
            missing = [
                one
                for one in value
                if CRITICS[plugin].format(one) not in exported(trees)
            ]
            yield prefix + key, f": no plugin {', '.join(missing)}" if missing else ""
        elif key != "plugin" and key not in COMMON:
            last = re.escape(str(key).rpartition(".")[2])
            known = any(
                re.search(rf"""["'](?:[\w.]*\.)?{last}["']""", source(place))
                for place in places
            )
            yield (
                prefix + key,
                ""
                if known
                else f" is not read by {', '.join(place.name for place in places)}",
            )


@cache
def source(folder):
    """Return all code of a package or a tree."""
    files = [
        one
        for end in ("cpp", "hpp", "h", "py")
        for one in folder.rglob(f"*.{end}")
        if "test" not in one.parts
    ]
    return "\n".join(file.read_text("utf-8", "replace") for file in files)


@cache
def exported(trees):
    """Return the classes that plugin descriptions export, by type and by name, each with the folders it is read in."""
    found = {}
    for tree in trees:
        for file in tree.rglob("*.xml"):
            # a tree of one package, or of many
            place = (
                tree
                if (tree / "package.xml").is_file()
                else tree / file.relative_to(tree).parts[0]
            )
            text = file.read_text("utf-8", "replace")
            for name in re.findall(
                r'<class\s[^>]*?\b(?:type|name)="([^"]+)"', text, re.DOTALL
            ):
                found[name] = (place,)
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
