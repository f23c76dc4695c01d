"""Check the parameters here against a source tree of Nav2: `python3 check_parameters.py PATH_TO_NAVIGATION2`.

Nav2 ignores parameters that it does not know, so that a misspelt one goes unnoticed. For every parameter, the name has
to occur as a quoted name in the source of the package that reads it; for every plugin, the class has to be exported
by one of the plugin descriptions. Prints each that does not, and how many were checked; exits with 1 if there are any.
"""

import re
import sys
from functools import cache
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
# where the parameters of a node, or of a plugin by the namespace of its class, are read
SOURCES = {
    "controller_server": ["nav2_controller", "nav2_dwb_controller/nav_2d_utils"],
    "local_costmap": ["nav2_costmap_2d"],
    "global_costmap": ["nav2_costmap_2d"],
    "planner_server": ["nav2_planner"],
    "behavior_server": ["nav2_behaviors"],
    "bt_navigator": ["nav2_bt_navigator", "nav2_behavior_tree"],
    "velocity_smoother": ["nav2_velocity_smoother"],
    "collision_monitor": ["nav2_collision_monitor"],
    "nav2_controller": ["nav2_controller"],
    "nav2_costmap_2d": ["nav2_costmap_2d"],
    "nav2_navfn_planner": ["nav2_navfn_planner"],
    "nav2_smac_planner": ["nav2_smac_planner"],
    "nav2_behaviors": ["nav2_behaviors"],
    "nav2_bt_navigator": ["nav2_bt_navigator"],
    "dwb_core": ["nav2_dwb_controller"],
    "nav2_graceful_controller": ["nav2_graceful_controller"],
    "nav2_mppi_controller": ["nav2_mppi_controller"],
    "nav2_regulated_pure_pursuit_controller": ["nav2_regulated_pure_pursuit_controller"],
}
# class of a critic by its short name, for the controllers that have critics
CRITICS = {
    "nav2_mppi_controller::MPPIController": "mppi::critics::{}",
    "dwb_core::DWBLocalPlanner": "dwb_critics::{}Critic",
}


def main(arguments):
    """Print what Nav2 does not know and return how the check went."""
    if len(arguments) != 1 or not (Path(arguments[0]) / "nav2_controller").is_dir():
        print("usage: check_parameters.py PATH_TO_NAVIGATION2", file=sys.stderr)
        return 2
    tree = Path(arguments[0])
    checked = 0
    unknown = []
    for path in sorted((HERE / "params").glob("*.yaml")):
        for node, values in parameters(path):
            for packages, name, plugins in leaves(values, SOURCES[node]):
                checked += 1
                last = name.rpartition(".")[2]
                if last != "plugin" and not knows(tree, tuple(packages), last):
                    unknown.append(f"{path.name}: {node}: {name} is not read by {', '.join(packages)}")
                missing = set(plugins) - exported(tree)
                unknown += [f"{path.name}: {node}: {name}: no plugin {plugin}" for plugin in sorted(missing)]
    print("\n".join([*unknown, f"{checked} parameters checked, {len(unknown)} unknown"]))
    return 1 if unknown else 0


def parameters(path):
    """Yield each node of a parameter file with its parameters."""
    for node, content in yaml.safe_load(path.read_text("utf-8")).items():
        # costmaps stand in a namespace of their own name
        yield node, content.get(node, content)["ros__parameters"]


def leaves(values, packages, prefix=""):
    """Yield (packages that read it, dotted name, classes that it names) of each parameter."""
    plugin = values.get("plugin", "")
    packages = SOURCES[plugin.split("::")[0]] if plugin else packages
    for key, value in values.items():
        if isinstance(value, dict):
            yield from leaves(value, packages, f"{prefix}{key}.")
        elif key == "critics":
            yield packages, prefix + key, [CRITICS[plugin].format(name) for name in value]
        else:
            yield packages, prefix + key, [value] if key == "plugin" else []


@cache
def source(tree, package):
    """Return all code of a package."""
    files = [*(tree / package).rglob("*.cpp"), *(tree / package).rglob("*.hpp")]
    return "\n".join(file.read_text("utf-8") for file in files if "/test/" not in str(file))


def knows(tree, packages, name):
    """Return whether one of the packages has the parameter's name, alone or after a prefix, in quotes."""
    return any(re.search(rf'"\.?{re.escape(name)}"', source(tree, package)) for package in packages)


@cache
def exported(tree):
    """Return the classes that the plugin descriptions export, by type and by name."""
    text = "\n".join(file.read_text("utf-8") for file in tree.rglob("*.xml"))
    return set(re.findall(r'<class\s[^>]*?\b(?:type|name)="([^"]+)"', text, re.DOTALL))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
