"""`barn worlds list`."""

from dataclasses import asdict
from typing import Any

import click

from barn_eval import worlds as world_sets
from barn_eval.commands.options import console, json_option, print_json, worlds_option
from barn_eval.commands.tables import table
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.world import World

# Of how obstacles move: heading, name of the figure, and its format.
_MOTION = (
    ("obstacles", "obstacles", ".1f"),
    ("m/s", "mean_speed_mps", ".2f"),
    ("from", "slowest_mps", ".2f"),
    ("to", "fastest_mps", ".2f"),
    ("period [s]", "period_s", ".1f"),
    ("crossings /min", "crossings_per_min", ".1f"),
    ("occupied", "occupied_share", ".3f"),
)


@click.command("list")
@click.argument("source", required=False)
@worlds_option
@click.option("--motion", is_flag=True, help="How the obstacles of SOURCE move, by class: means over the worlds.")
@json_option
def command(source: str | None, spec: str, motion: bool, as_json: bool) -> None:
    """List the data sets that come with the suite, or the worlds of SOURCE.

    Motion is that of the first 100 s. Crossings are of the straight line from start to goal by the centres of
    obstacles; occupied is the share of that line that obstacles cover.
    """
    if motion and source is None:
        raise click.UsageError("--motion needs SOURCE")
    if motion:
        found = world_sets.motion(str(source), spec)
        entries = [{"class": name, "worlds": count, **asdict(figures)} for name, count, figures in found]
        columns = ("class", ">n", *(f">{heading}" for heading, _, _ in _MOTION))
        rows = [
            [one["class"], str(one["worlds"]), *(f"{one[key]:{form}}" for _, key, form in _MOTION)] for one in entries
        ]
    else:
        entries = _datasets() if source is None else [_entry(*one) for one in world_sets.load(source, spec).items()]
        columns = tuple(entries[0]) if entries else ("nothing there",)
        rows = [[f"{one:.2f}" if isinstance(one, float) else str(one) for one in entry.values()] for entry in entries]
    print_json(entries) if as_json else console.print(table(columns, rows))


def _datasets() -> list[dict[str, Any]]:
    opened = [open_dataset(name) for name in world_sets.datasets()]
    return [{"data set": one.name, "worlds": len(one.indices), "checksum": one.checksum[:16]} for one in opened]


def _entry(index: int, world: World) -> dict[str, Any]:
    return {
        "world": index,
        "name": world.name,
        "cells": f"{world.rows} x {world.cols}",
        "filled": int(world.grid.sum()),
        "path [m]": world.path_length_m,
        "source": world.provenance.source,
        "checksum": world.checksum[:16],
    }
