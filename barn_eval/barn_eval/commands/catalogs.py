"""`barn robots`, `barn planners` and `barn protocols`: list them, or show one."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from barn_eval.analysis.planners import spelling
from barn_eval.api.robots import draw
from barn_eval.commands.options import (
    PLANNER,
    PROTOCOL,
    ROBOT,
    file_option,
    json_option,
    print_notes,
    print_output,
)
from barn_eval.commands.tables import quantities_table, table, value_text
from barn_eval.trials.protocol import PROTOCOLS, load_protocol
from barn_planners.registry import planner_entry, planner_names
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.robots.files import ROBOTS, load_robot


@click.command("robots")
@click.argument("robot", type=ROBOT, required=False)
@file_option("--out", help="Picture of ROBOT from above (.png, .svg or .pdf).")
@json_option
def robots(robot: str | None, out: Path | None, as_json: bool) -> None:
    """List the robots of the suite, or show all values of ROBOT (a name or a YAML file) and their sources."""
    if robot is None:
        if out is not None:
            raise click.UsageError("--out needs ROBOT")
        entries = [
            {
                "robot": details.name,
                "drive": details.chassis.kind,
                "length [m]": details.length_m,
                "width [m]": details.width_m,
                "mass [kg]": details.chassis.mass_kg,
                "speed [m/s]": details.drive.max_speed_m_s,
                "yaw rate [rad/s]": details.drive.max_yaw_rate_rad_s,
            }
            for details in ROBOTS.values()
        ]
        # All but name and drive are numbers.
        _print_entries(as_json, entries, list(entries[0])[2:])
        return

    # A file of the user is shown like a robot of the suite.
    details = load_robot(robot)
    if out is not None:
        draw(details).save(out)
        print_notes(out)
    title = f"{details.name}: {details.summary}"
    # Name and summary are the title.
    tables = [quantities_table(details, title, ("name", "summary"))]
    if details.sources:
        tables.append(table(("section", "sources"), details.sources.items()))
    print_output(as_json, {"name": details.name, **as_dict(details)}, *tables)


@click.command("planners")
@click.argument("planner", type=PLANNER, required=False, metavar="[NAME[:PRESET]]")
@json_option
def planners(planner: str | None, as_json: bool) -> None:
    """List all planners and their presets, or show the parameters of NAME with units and meanings.

    Without PRESET, this shows the values of the first preset. To change a parameter, use
    barn run --set NAME.PARAMETER=VALUE.
    """
    if planner is None:
        entries = []
        for name in planner_names():
            entry = planner_entry(name)
            entries.append(
                {
                    "planner": name,
                    "presets": tuple(entry.presets),
                    "summary": entry.summary,
                }
            )
        _print_entries(as_json, entries)
        return

    name, _colon, preset = planner.partition(":")
    presets = planner_entry(name).presets
    preset = preset or next(iter(presets))
    if preset not in presets:
        raise ConfigError(
            f"planner {name} has no preset {preset!r}{suggest(preset, presets)}"
        )
    config = presets[preset]
    title = f"{spelling(name)}, preset {preset}"
    details = {"planner": name, "preset": preset, "parameters": as_dict(config)}
    print_output(as_json, details, quantities_table(config, title))


@click.command("protocols")
@click.argument("name", type=PROTOCOL, required=False)
@json_option
def protocols(name: str | None, as_json: bool) -> None:
    """List the protocols of the suite, or show all rules of NAME, a protocol or a YAML file."""
    if name is None:
        entries = [
            {
                "protocol": rules.name,
                "metric": rules.metric,
                "limit [s]": rules.limit_s,
                "map": "given" if rules.map_given else "none",
                "obstacles": "moving" if rules.arena else "static",
            }
            for rules in PROTOCOLS.values()
        ]
        _print_entries(as_json, entries, ("limit [s]",))
        return

    details = load_protocol(name)
    title = f"protocol {details.name}"
    print_output(as_json, as_dict(details), quantities_table(details, title, ("name",)))


def _print_entries(
    as_json: bool, entries: list[dict[str, Any]], numbers: Iterable[str] = ()
) -> None:
    """Print a table with a row per entry and its keys as headings, or JSON.

    Columns in `numbers` are aligned to the right.
    """
    columns = [f">{key}" if key in numbers else key for key in entries[0]]
    rows = [list(map(value_text, entry.values())) for entry in entries]
    print_output(as_json, entries, table(columns, rows))
