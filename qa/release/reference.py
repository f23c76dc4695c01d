"""The tables of parameters in the READMEs and the files for `--params-file`.

Both are made from the configurations themselves.

`qa/release/regenerate.py` writes them, and a test in each package checks that they are
current.
"""

# A package is imported only for its own reference: not every place has all, or ROS.
# ruff: noqa: PLC0415
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from barn_worlds.base.config import fields_of
from barn_worlds.base.files import markdown_table

_NOTHING: Mapping[str, Any] = MappingProxyType({})
SIMULATOR = "/**/simulator"
# Meanings of parameters that no configuration declares.
_FIRST_MEANINGS = {
    "planner": "name of the planner",
    "use_sim_time": "take the time from /clock",
}


@dataclass(frozen=True)
class Reference:
    """The generated parts of a package.

    Sections of README.md and files in the folder config.

    sections: Markdown by the NAME in `<!-- NAME: begin -->` and `<!-- NAME: end -->`.
    files: parameter files by name.
    """

    sections: Mapping[str, str]
    files: Mapping[str, str]

    def contents(self, package: Path) -> dict[Path, str]:
        """Return the content that each file should have.

        Raises:
            ValueError: If the README lacks a marker.
        """
        readme = package / "README.md"
        text = readme.read_text("utf-8")
        for name, section in self.sections.items():
            begin = f"<!-- {name}: begin -->"
            end = f"<!-- {name}: end -->"
            before, marker, rest = text.partition(begin)
            _, closed, after = rest.partition(end)
            if not marker or not closed:
                raise ValueError(f"{readme}: lacks {begin} ... {end}")
            text = f"{before}{begin}\n\n{section}\n\n{end}{after}"
        return {readme: text} | {
            package / "config" / name: text for name, text in self.files.items()
        }

    def write(self, package: Path) -> None:
        """Write the files."""
        for path, text in self.contents(package).items():
            path.write_text(text, "utf-8")

    def outdated(self, package: Path) -> list[str]:
        """Return the files that are not current or should not exist."""
        contents = self.contents(package)
        written = {
            path: path.read_text("utf-8")
            for path in (package / "README.md", *package.glob("config/*.yaml"))
        }
        return sorted(
            path.name
            for path in {*contents, *written}
            if contents.get(path) != written.get(path)
        )


def parameter_table(columns: Mapping[str, Any], leave_out: Collection[str] = ()) -> str:
    """Return a Markdown table of parameters.

    `columns` is configurations of one class by heading.
    """
    values = [
        {name: value for name, _, value in fields_of(config)}
        for config in columns.values()
    ]
    rows = [
        [
            f"`{name}`",
            *(_cell(config[name]) for config in values),
            parameter.unit,
            parameter.summary(unit=False),
        ]
        for name, parameter, _ in fields_of(next(iter(columns.values())))
        if name not in leave_out
    ]
    return markdown_table(["parameter", *columns, "unit", "meaning"], rows)


def parameter_file(
    node: str,
    title: str,
    configs: Sequence[Any],
    first: Mapping[str, Any] = _NOTHING,
    leave_out: Collection[str] = (),
) -> str:
    """Return a file with all parameters of a node, each with its meaning.

    node: which nodes it is for, such as "/**/simulator" (that node in any namespace).
    first: parameters that are in no configuration. A parameter that is in two of them
    has the value of the last.
    """
    parameters = {
        name: (parameter, value)
        for config in configs
        for name, parameter, value in fields_of(config)
    }
    lines = [f"# {title}", f"{node}:", "  ros__parameters:"]
    for name, value in first.items():
        if name in _FIRST_MEANINGS:
            lines.append(f"    # {_FIRST_MEANINGS[name]}")
        lines.append(f"    {_entry(name, value)}")
    for name, (parameter, value) in parameters.items():
        if name not in leave_out:
            lines += [f"    # {parameter.summary()}", f"    {_entry(name, value)}"]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        items = []
        for item in value:
            cell = _cell(item)
            items.append(f"({cell})" if isinstance(item, tuple) else cell)
        return ", ".join(items)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _entry(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        items = yaml.safe_dump(list(value), default_flow_style=True, width=1000)
        return f"{name}: {items.strip()}"
    return yaml.safe_dump({name: value}, width=1000).strip()


def worlds() -> Reference:
    """Return the tables of map server and chassis, and the parameter file."""
    from barn_worlds.robots.files import ROBOTS
    from barn_worlds.ros.map_server import MapServerConfig

    defaults = MapServerConfig()
    chassis = {
        name: ROBOTS[name].chassis
        for name in ("jackal", "turtlebot4", "turtlebot3_burger")
    }
    return Reference(
        {
            "parameters": parameter_table({"default": defaults}),
            "chassis": parameter_table(chassis, leave_out=["name"]),
        },
        {
            "map_server.yaml": parameter_file(
                "/**/map_server", "The map server with its defaults.", [defaults]
            )
        },
    )


def simulator() -> Reference:
    """Return the tables and the parameter files.

    One file has all parameters, one per preset those that differ from the default.
    """
    from barn_sim.config import PRESETS, RunConfig, SimulatorConfig, SimulatorNodeConfig

    node = SimulatorNodeConfig()
    default = {name: value for name, _, value in fields_of(SimulatorConfig())}
    title = "The simulator with its defaults."
    files = {
        "simulator.yaml": parameter_file(
            SIMULATOR, title, [node, RunConfig()], leave_out=["evaluator_fd"]
        )
    }
    for preset, config in PRESETS.items():
        same = {name for name, _, value in fields_of(config) if value == default[name]}
        if preset != "default":
            title = f"The simulator as in the preset {preset}: what differs from the default."
            files[f"{preset}.yaml"] = parameter_file(
                SIMULATOR, title, [config], leave_out=same
            )
    sections = {
        "run parameters": parameter_table({"default": RunConfig()}, leave_out=default),
        "simulator parameters": parameter_table(PRESETS),
        "node parameters": parameter_table({"default": node}),
    }
    return Reference(sections, files)


def planners() -> Reference:
    """Return the tables of the node and this suite's planners, and a file per preset.

    A file is for a node of any name: each planner has an executable of its own.
    """
    from barn_planners.registry import planner_entry, planner_names
    from barn_planners.ros.planner import NodeConfig
    from barn_planners.runtime.synchronizer import SyncConfig

    entries = {name: planner_entry(name) for name in planner_names()}
    ours = {
        name: entry
        for name, entry in entries.items()
        if entry.config_class.__module__.startswith("barn_planners.")
    }
    texts = []
    title = "The node of any planner with its defaults."
    text = parameter_file("/**/planner", title, [NodeConfig()], {"planner": "dwa"})
    files = {"planner.yaml": text}
    for name, entry in ours.items():
        summary = entry.summary[:1].upper() + entry.summary[1:]
        texts.append(f"### `{name}`\n\n{summary}.\n\n{parameter_table(entry.presets)}")
        for preset, config in entry.presets.items():
            node = replace(
                NodeConfig(), preset=preset, use_map=preset.startswith("paper")
            )
            title = f"The planner {name} with its preset {preset}."
            text = parameter_file(
                "/**",
                title,
                [node, SyncConfig(), config],
                {"planner": name, "use_sim_time": True},
            )
            files[
                f"{name}.yaml" if len(entry.presets) == 1 else f"{name}_{preset}.yaml"
            ] = text
    sections = {
        "node parameters": parameter_table({"default": NodeConfig()}),
        "reading parameters": parameter_table({"default": SyncConfig()}),
        "planner parameters": "\n\n".join(texts),
    }
    return Reference(sections, files)


def evaluator() -> Reference:
    """Return the tables and the parameter file.

    What only a supervisor sets is left out of the file.
    """
    from barn_eval.commands.main import COMMANDS
    from barn_eval.trials.protocol import PROTOCOLS
    from barn_eval.trials.ros_config import EvaluatorConfig, RosConfig

    defaults = EvaluatorConfig()
    sections = {
        "commands": markdown_table(
            ["command", ""],
            [[f"`barn {name}`", summary] for name, summary in COMMANDS.items()],
        ),
        "protocols": parameter_table(PROTOCOLS),
        "ros settings": parameter_table({"default": RosConfig()}),
        "evaluator parameters": parameter_table({"default": defaults}),
    }
    title = "The evaluator with its defaults."
    file = parameter_file(
        "/**/evaluator",
        title,
        [defaults],
        leave_out=["assignment", "supervisor_fd", "simulator_fd"],
    )
    return Reference(sections, {"evaluator.yaml": file})


REFERENCES: Mapping[str, Callable[[], Reference]] = {
    "barn_worlds": worlds,
    "barn_sim": simulator,
    "barn_planners": planners,
    "barn_eval": evaluator,
}
