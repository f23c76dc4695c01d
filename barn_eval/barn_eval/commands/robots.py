"""`barn robots`: the robots of the suite, and all numbers of one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from barn_eval.api.robots import draw
from barn_eval.commands.options import (
    file_option,
    json_option,
    print_notes,
    print_output,
)
from barn_eval.commands.tables import table
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.robots.files import ROBOTS, load_robot
from barn_worlds.robots.robot import Robot


@click.command("robots")
@click.argument("robot", required=False)
@file_option("--out", help="Draw it from above, as .png, .svg or .pdf.")
@json_option
def command(robot: str | None, out: Path | None, as_json: bool) -> None:
    """List the robots that come with the suite, or show all numbers of ROBOT, a name or a YAML file, with sources."""
    if robot is None:
        if out is not None:
            raise click.UsageError("--out needs ROBOT")
        _print_list(as_json)
        return

    # A file of the user is shown like a robot of the suite.
    details = load_robot(robot)
    if out is not None:
        draw(details).save(out)
        print_notes(out)
    tables = [
        table(
            ("quantity", "value", "unit", "meaning"),
            _quantities(details),
            title=f"{details.name}: {details.summary}",
        )
    ]
    if details.sources:
        tables.append(table(("section", "sources"), details.sources.items()))
    print_output(as_json, {"name": details.name, **as_dict(details)}, *tables)


def _print_list(as_json: bool) -> None:
    """Print the robots of the suite as a table or as JSON."""
    entries: list[dict[str, Any]] = [
        {
            "robot": robot.name,
            "drive": robot.chassis.kind,
            "length [m]": robot.length_m,
            "width [m]": robot.width_m,
            "mass [kg]": robot.chassis.mass_kg,
            "speed [m/s]": robot.drive.max_speed_m_s,
            "yaw rate [rad/s]": robot.drive.max_yaw_rate_rad_s,
        }
        for robot in ROBOTS.values()
    ]
    # Numbers are aligned to the right; these two are texts.
    columns = []
    for key in entries[0]:
        if key in ("robot", "drive"):
            columns.append(key)
        else:
            columns.append(f">{key}")
    rows = [list(map(_format, entry.values())) for entry in entries]
    print_output(as_json, entries, table(columns, rows))


def _quantities(robot: Robot) -> Iterator[tuple[str, str, str, str]]:
    """Yield dotted name, value, unit and meaning of each quantity of a robot."""
    content = as_dict(robot)
    for name, quantity, value in fields_of(robot):
        section, _, key = name.rpartition(".")
        # Plain data leave out optional quantities that the robot does not have.
        is_present = key in (content[section] if section else content)
        if is_present and key not in ("name", "summary"):
            yield name, _format(value), quantity.unit, quantity.description


def _format(value: object) -> str:
    """Return a value as text: floats with five digits, tuples joined by commas."""
    if isinstance(value, tuple):
        parts = []
        for part in value:
            text = _format(part)
            if isinstance(part, tuple):
                text = f"({text})"
            parts.append(text)
        return ", ".join(parts)
    return f"{value:.5g}" if isinstance(value, float) else str(value)
