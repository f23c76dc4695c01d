"""A campaign for tests of pages: one trial that was driven, its bag, and rows of many others made from it."""

import json
import shutil
from dataclasses import replace

import numpy as np
from planners import dataset_of

import barn_eval as barn
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import read_results
from barn_eval.results.provenance import provenance
from barn_eval.results.rows import read_tracks, seal_line, unseal_line
from barn_eval.results.run_file import RunFile
from barn_eval.results.tracks import thin_samples
from barn_eval.trials import identity
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import format_trial_id, to_json_line
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_eval.trials.trajectory import compute_clearances
from barn_worlds.base.config import as_dict
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import STANDARD_ROBOT

SCORES = ("traversal_time_s", "normalised_time_s_per_m", "challenge")
EVIL = "</script><script>window.evil=1</script>"


def rewrite_rows(folder, change):
    """Write the rows of a folder again, as `change` makes them of what they were, with checksums that are right."""
    path = folder / "results.jsonl"
    rows = change(
        [
            json.loads(unseal_line(line, path.name))
            for line in path.read_text().splitlines()
        ]
    )
    path.write_text("".join(f"{seal_line(json.dumps(row))}\n" for row in rows))
    return rows


def change_row(folder, number=0, **changes):
    """Change a row of a folder by names, in its parts by dotted names with "__", and return it."""

    def change(rows):
        for key, value in changes.items():
            part, _, last = key.rpartition("__")
            (rows[number][part] if part else rows[number])[last] = value
        return rows

    return rewrite_rows(folder, change)[number]


def recorded_track(bag, world):
    """The track of a trial as its bag has it."""
    recorded = read_recorded_trial(bag)
    gaps = compute_clearances(
        recorded.poses,
        world.cylinders_m,
        world.cylinder_radius_m,
        contact_footprint(STANDARD_ROBOT.chassis),
    )
    samples = [
        recorded.times_s,
        recorded.poses,
        recorded.speeds,
        recorded.commands,
        gaps,
    ]
    return thin_samples(np.column_stack(samples), recorded.contact)


def drive(path, protocol=CHALLENGE, planners=("gap",), worlds="0"):
    """Drive a trial of each planner in each world, with bags, and return the folder."""
    options = {
        "dataset": dataset_of(protocol),
        "seed": 5,
        "bags": "all",
        "engine": "inline",
        "progress": False,
    }
    return barn.run(worlds, list(planners), protocol, out=path, **options).folder


def campaign(
    path,
    run,
    planners=("gap", "dwa"),
    worlds=8,
    repetitions=2,
    bags=3,
    faster=0.3,
    protocol=CHALLENGE,
):
    """Write a campaign of rows: the second planner is slower, every fifth trial fails; some have track and bag."""
    (model,) = read_results(run)
    rules = {
        "dataset": dataset_of(protocol),
        "protocol": protocol,
        "simulator": simulator_config(protocol),
    }
    task = identity.fingerprint(identity.task_content(protocol, rules["simulator"]))
    of_rules = {"protocol": protocol.name, "metric": protocol.metric, "task": task}
    dataset = open_dataset(rules["dataset"])
    path.mkdir()
    track = json.loads(next(iter(read_tracks(run).values())))
    lines = []
    tracks = []
    left = bags
    for world in range(worlds):
        of_world = {
            "world": world,
            "world_name": EVIL,
            "world_checksum": dataset.load(world).checksum,
        }
        for repetition in range(repetitions):
            for place, planner in enumerate(planners):
                name = format_trial_id(planner, world, repetition)
                fails = (world + repetition) % 5 == 4
                time_s = 10.0 + world + 0.1 * repetition + faster * place
                figures = (
                    (50.0, 10.0, 0.0) if fails else (time_s, time_s / 5.0, 2.0 / time_s)
                )
                scores = dict(zip(SCORES, figures, strict=True))
                ended = {
                    "scores": replace(model.scores, success=not fails, **scores),
                    "detail": EVIL if fails else "",
                }
                ended |= {"outcome": Outcome.TIMEOUT if fails else Outcome.SUCCESS}
                rows = {
                    "planner": planner,
                    "repetition": repetition,
                    "simulator_seed": 100 * world + repetition,
                }
                row = replace(
                    model, trial_id=name, **of_world, **rows, **of_rules, **ended
                )
                lines.append(seal_line(to_json_line(row)))
                if left and world == 0:
                    shutil.copytree(run / "bags" / model.trial_id, path / "bags" / name)
                    tracks.append(
                        seal_line(json.dumps(track | {"trial_id": name})) + "\n"
                    )
                    left -= 1
    rules |= {
        "worlds": f"0:{worlds}",
        "repetitions": repetitions,
        "seed": 5,
        "bags": "all" if bags else "none",
    }
    experiment = RunConfig(planners=tuple(map(PlannerChoice, planners)), **rules)
    session = {
        "started_at": "2026-01-01T00:00:00+00:00",
        "execution": as_dict(ExecutionConfig()),
    } | provenance()
    replace(RunFile.for_run(path, experiment, []), sessions=(session,)).write()
    (path / "results.jsonl").write_text("\n".join(lines) + "\n")
    (path / "tracks.jsonl").write_text("".join(tracks))
    return path
