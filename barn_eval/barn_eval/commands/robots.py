"""`barn robots`: the robots that there are, all that is known of one, and whether one drives as theory says."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval.commands.options import FILE, console, json_option, print_json, say, tell
from barn_eval.commands.tables import table
from barn_eval.robots import draw
from barn_sim.checks.self_test import LARGEST_DEVIATION, self_test
from barn_worlds.base.config import as_dict, fields_of
from barn_worlds.robots.files import ROBOTS, load_robot
from barn_worlds.robots.robot import Robot


@click.command("robots")
@click.argument("robot", required=False)
@click.option("--out", type=FILE, help="Draw it from above, as .png, .svg or .pdf.")
@click.option("--check", is_flag=True, help="Drive it: straight, turns, arcs and stops, and compare with theory.")
@json_option
def command(robot: str | None, out: Path | None, check: bool, as_json: bool) -> int:
    """List the robots that come with the suite, or show all numbers of ROBOT, a name or a YAML file, with sources.

    --check compares speeds, yaw rates and distances with those of a planar model from theory. It returns 1 if one is
    more than 3 % off, or if the file describes no robot, which is said in one line.
    """
    if robot is None:
        if out is not None or check:
            raise click.UsageError("--out and --check need ROBOT")
        entries = list(map(_entry, ROBOTS.values()))
        columns = [key if key in ("robot", "drive") else f">{key}" for key in entries[0]]
        tell(as_json, entries, table(columns, [[*map(_shown, entry.values())] for entry in entries]))
        return 0
    found = load_robot(robot)
    if out is not None:
        draw(found).save(out)
        say(out)
    if check:
        return _check(found, as_json)
    shown = [table(("quantity", "value", "unit", "meaning"), _numbers(found), title=f"{found.name}: {found.summary}")]
    shown += [table(("section", "sources"), found.sources.items())] if found.sources else []
    tell(as_json, {"name": found.name, **as_dict(found)}, *shown)
    return 0


def _check(found: Robot, as_json: bool) -> int:
    """Drive a robot, print how, and return the exit code."""
    driven = self_test(found)
    beyond = [one for one in driven if not one.passed]
    if as_json:
        measured = [{**asdict(one), "deviation": one.deviation, "passed": one.passed} for one in driven]
        print_json({**_entry(found), "passed": not beyond, "self_test": measured})
        return int(bool(beyond))
    drive, chassis = found.drive, found.chassis
    size = f"{found.length_m:.3g} x {found.width_m:.3g} x {chassis.body_height_m:.3g} m, {chassis.mass_kg:.4g} kg"
    limits = f"{drive.max_speed_m_s:g} m/s, {drive.max_yaw_rate_rad_s:g} rad/s"
    click.echo(f"{found.name}: {chassis.kind}, {size}, up to {limits}")
    rows = []
    for one in driven:
        asked = "" if one.asked is None else f"{one.asked:.3f}"
        deviation = f"{100 * one.deviation:+.1f} %{'' if one.passed else ' !'}"
        quantity = f"{one.quantity} [{one.unit}]"
        rows.append((one.manoeuvre, quantity, asked, f"{one.theory:.3f}", f"{one.simulated:.3f}", deviation))
    console.print(table(("manoeuvre", "quantity", ">asked", ">theory", ">simulated", ">deviation"), rows))
    worst = max(abs(one.deviation) for one in driven)
    verdict = f"does not drive as theory says in {len(beyond)} respects" if beyond else "drives as theory says"
    click.echo(f"{found.name} {verdict}: at most {100 * worst:.1f} % off, {100 * LARGEST_DEVIATION:g} % allowed")
    return int(bool(beyond))


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
        if key not in ("name", "summary") and key in (plain[section] if section else plain):
            yield name, _shown(value), about.unit, about.description


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"({_shown(one)})" if isinstance(one, tuple) else _shown(one) for one in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)
