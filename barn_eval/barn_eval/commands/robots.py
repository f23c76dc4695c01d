"""`barn robots`: the robots that there are, all that is known of one, and whether one drives as theory says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval.commands.options import FILE, console, json_option, print_json, say
from barn_eval.commands.tables import table
from barn_worlds.base.config import Quantity, as_dict, fields_of
from barn_worlds.base.errors import ConfigError
from barn_worlds.robots.files import ROBOTS, load_robot, refusals
from barn_worlds.robots.robot import Robot

if TYPE_CHECKING:
    from barn_sim.checks.self_test import Measured

PICTURES = (".png", ".svg")
_SHOWN_DIGITS = 5


@click.group()
def robots() -> None:
    """List, show and check robots."""


@robots.command("list")
@json_option
def list_robots(as_json: bool) -> None:
    """List the robots that come with the suite."""
    entries = [_entry(robot) for robot in ROBOTS.values()]
    if as_json:
        print_json(entries)
        return
    columns = [key if key in ("robot", "drive") else f">{key}" for key in entries[0]]
    console.print(table(columns, [[_shown(value) for value in entry.values()] for entry in entries]))
    for why in refusals().values():
        say(why)


@robots.command()
@click.argument("robot")
@click.argument("picture", type=FILE, required=False)
@json_option
def show(robot: str, picture: Path | None, as_json: bool) -> None:
    """Show all numbers of ROBOT, a name or a YAML file, with units and sources.

    It is drawn from above to PICTURE, a .png or .svg.
    """
    found = load_robot(robot)
    if picture is not None:
        if picture.suffix not in PICTURES:
            raise ConfigError(f"{picture}: a picture must end in {' or '.join(PICTURES)}")
        from barn_eval.known_robots import draw_robot  # noqa: PLC0415 (matplotlib)

        draw_robot(found).save(picture)
        say(picture)
    if as_json:
        print_json({"name": found.name, **as_dict(found)})
        return
    rows = [[name, _shown(value), about.unit, about.description] for name, about, value in _numbers(found)]
    console.print(table(("quantity", "value", "unit", "meaning"), rows, title=f"{found.name}: {found.summary}"))
    if found.sources:
        console.print(table(("section", "sources"), list(found.sources.items())))


@robots.command()
@click.argument("robot")
@json_option
def check(robot: str, as_json: bool) -> int:
    """Say what ROBOT is, a name or a YAML file, and drive it: straight, turns, arcs and stops.

    Speeds, yaw rates and distances are compared with those of a planar model from theory. Returns 1 if one is more
    than 3 % off, or if the file describes no robot, which it says in one line.
    """
    from barn_sim.checks.self_test import LARGEST_DEVIATION, self_test  # noqa: PLC0415 (PyBullet)

    found = load_robot(robot)
    driven = self_test(found)
    beyond = [one for one in driven if not one.passed]
    if as_json:
        print_json({**_entry(found), "passed": not beyond, "self_test": [_measurement(one) for one in driven]})
    else:
        drive, chassis = found.drive, found.chassis
        size = f"{found.length_m:.3g} x {found.width_m:.3g} x {chassis.body_height_m:.3g} m, {chassis.mass_kg:.4g} kg"
        limits = f"{drive.max_speed_m_s:g} m/s, {drive.max_yaw_rate_rad_s:g} rad/s"
        click.echo(f"{found.name}: {chassis.kind}, {size}, up to {limits}")
        columns = ("manoeuvre", "quantity", ">asked", ">theory", ">simulated", ">deviation")
        console.print(table(columns, [_row(one) for one in driven]))
        worst = max(abs(one.deviation) for one in driven)
        verdict = "drives as theory says" if not beyond else f"does not drive as theory says in {len(beyond)} respects"
        click.echo(f"{found.name} {verdict}: at most {100 * worst:.1f} % off, {100 * LARGEST_DEVIATION:g} % allowed")
    return 1 if beyond else 0


def _measurement(one: Measured) -> dict[str, Any]:
    return {**asdict(one), "deviation": one.deviation, "passed": one.passed}


def _row(one: Measured) -> list[str]:
    asked = "" if one.asked is None else f"{one.asked:.3f}"
    mark = "" if one.passed else " !"
    return [
        one.manoeuvre, f"{one.quantity} [{one.unit}]", asked, f"{one.theory:.3f}", f"{one.simulated:.3f}",
        f"{100 * one.deviation:+.1f} %{mark}",
    ]  # fmt: skip


def _entry(robot: Robot) -> dict[str, Any]:
    drive = robot.drive
    return {
        "robot": robot.name,
        "drive": robot.chassis.kind,
        "length [m]": robot.length_m,
        "width [m]": robot.width_m,
        "mass [kg]": robot.chassis.mass_kg,
        "speed [m/s]": drive.max_speed_m_s,
        "yaw rate [rad/s]": drive.max_yaw_rate_rad_s,
    }


def _numbers(robot: Robot) -> Iterator[tuple[str, Quantity, Any]]:
    """Yield what a table shows of a robot: all but names, summary and what it does not have."""
    plain = as_dict(robot)
    for name, about, value in fields_of(robot):
        section, _, key = name.rpartition(".")
        if key not in ("name", "summary") and key in (plain[section] if section else plain):
            yield name, about, value


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"({_shown(one)})" if isinstance(one, tuple) else _shown(one) for one in value)
    return f"{value:.{_SHOWN_DIGITS}g}" if isinstance(value, float) else str(value)
