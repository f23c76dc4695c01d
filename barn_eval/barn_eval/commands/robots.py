"""`barn robots`: the robots that there are, and all that is known of one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from barn_eval.api.robots import draw
from barn_eval.commands.options import FILE, json_option, print_notes, print_output
from barn_eval.commands.tables import table
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.robots.files import ROBOTS, load_robot
from barn_worlds.robots.robot import Robot


@click.command("robots")
@click.argument("robot", required=False)
@click.option("--out", type=FILE, help="Draw it from above, as .png, .svg or .pdf.")
@json_option
def command(robot: str | None, out: Path | None, as_json: bool) -> None:
    """List the robots that come with the suite, or show all numbers of ROBOT, a name or a YAML file, with sources."""
    if robot is None:
        if out is not None:
            raise click.UsageError("--out needs ROBOT")
        entries = list(map(_entry, ROBOTS.values()))
        columns = [
            key if key in ("robot", "drive") else f">{key}" for key in entries[0]
        ]
        print_output(
            as_json,
            entries,
            table(columns, [[*map(_shown, entry.values())] for entry in entries]),
        )
        return
    found = load_robot(robot)
    if out is not None:
        draw(found).save(out)
        print_notes(out)
    shown = [
        table(
            ("quantity", "value", "unit", "meaning"),
            _numbers(found),
            title=f"{found.name}: {found.summary}",
        )
    ]
    shown += (
        [table(("section", "sources"), found.sources.items())] if found.sources else []
    )
    print_output(as_json, {"name": found.name, **as_dict(found)}, *shown)


def _entry(robot: Robot) -> dict[str, Any]:
    return {
        "robot": robot.name,
        "drive": robot.chassis.kind,
        "length [m]": robot.length_m,
        "width [m]": robot.width_m,
        "mass [kg]": robot.chassis.mass_kg,
        "speed [m/s]": robot.drive.max_speed_m_s,
        "yaw rate [rad/s]": robot.drive.max_yaw_rate_rad_s,
    }


def _numbers(robot: Robot) -> Iterator[tuple[str, str, str, str]]:
    """Yield what a table shows of a robot: all but names, summary and what it does not have."""
    plain = as_dict(robot)
    for name, about, value in fields_of(robot):
        section, _, key = name.rpartition(".")
        if key not in ("name", "summary") and key in (
            plain[section] if section else plain
        ):
            yield name, _shown(value), about.unit, about.description


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(
            f"({_shown(one)})" if isinstance(one, tuple) else _shown(one)
            for one in value
        )
    return f"{value:.5g}" if isinstance(value, float) else str(value)
