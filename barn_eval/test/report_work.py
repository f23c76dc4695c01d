"""A campaign for tests of pages.

One trial that was driven, its bag, and rows of many others made from it.
"""

import json
import shutil
from dataclasses import replace
from itertools import product

import numpy as np
from planners import dataset_of, run_inline

from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import read_results
from barn_eval.results.provenance import provenance
from barn_eval.results.rows import TRACKS_FILE, TrialLines, seal_line, unseal_line
from barn_eval.results.run_file import RunFile
from barn_eval.results.tracks import thin_samples
from barn_eval.trials import identity
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Outcome, format_trial_id, to_json_line
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
    """Write the rows of a folder again, as `change` makes them of what they were, with
    checksums that are right.
    """
    path = folder / "results.jsonl"
    lines = path.read_text().splitlines()
    rows = change([json.loads(unseal_line(line, path.name)) for line in lines])
    path.write_text("".join(f"{seal_line(json.dumps(row))}\n" for row in rows))
    return rows


def change_row(folder, number=0, **changes):
    """Change a row of a folder by names, in its parts by dotted names with "__", and
    return it.
    """

    def change(rows):
        for key, value in changes.items():
            part, _, last = key.rpartition("__")
            (rows[number][part] if part else rows[number])[last] = value
        return rows

    return rewrite_rows(folder, change)[number]


def recorded_track(bag, world):
    """The track of a trial as its bag has it."""
    recorded = read_recorded_trial(bag)
    cylinders = (world.cylinders_m, world.cylinder_radius_m)
    outline = contact_footprint(STANDARD_ROBOT.chassis)
    gaps = compute_clearances(recorded.poses, *cylinders, outline)
    motion = [recorded.times_s, recorded.poses, recorded.speeds, recorded.commands]
    return thin_samples(np.column_stack([*motion, gaps]), recorded.contact)


def drive(path, protocol=CHALLENGE, planners=("gap",), worlds="0"):
    """Drive a trial of each planner in each world, with bags, and return the folder."""
    options = {"dataset": dataset_of(protocol), "seed": 5, "bags": "all", "out": path}
    return run_inline(worlds, list(planners), protocol, **options).folder


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
    """Write a campaign of rows.

    The second planner is slower, every fifth trial fails; some have track and bag.
    """
    config = RunConfig(
        dataset=dataset_of(protocol),
        protocol=protocol,
        simulator=simulator_config(protocol),
        planners=tuple(map(PlannerChoice, planners)),
        worlds=f"0:{worlds}",
        repetitions=repetitions,
        seed=5,
        bags="all" if bags else "none",
    )
    task = identity.fingerprint(identity.task_content(protocol, config.simulator))
    (row,) = read_results(run)
    trial_id = row.trial_id
    row = replace(row, protocol=protocol.name, metric=protocol.metric, task=task)
    dataset = open_dataset(config.dataset)
    path.mkdir()
    track = json.loads(next(iter(TrialLines(run / TRACKS_FILE).values())))
    lines = []
    tracks = []
    left = bags
    cases = product(range(worlds), range(repetitions), enumerate(planners))
    for world, repetition, (place, planner) in cases:
        name = format_trial_id(planner, world, repetition)
        time_s = 10.0 + world + 0.1 * repetition + faster * place
        figures = (time_s, time_s / 5.0, 2.0 / time_s)
        fails = (world + repetition) % 5 == 4
        if fails:
            figures = (50.0, 10.0, 0.0)
        scores = dict(zip(SCORES, figures, strict=True))
        changed = replace(
            row,
            trial_id=name,
            world=world,
            world_name=EVIL,
            world_checksum=dataset.load(world).checksum,
            planner=planner,
            repetition=repetition,
            simulator_seed=100 * world + repetition,
            outcome=Outcome.TIMEOUT if fails else Outcome.SUCCESS,
            detail=EVIL if fails else "",
            scores=replace(row.scores, success=not fails, **scores),
        )
        lines.append(seal_line(to_json_line(changed)))
        if left and world == 0:
            shutil.copytree(run / "bags" / trial_id, path / "bags" / name)
            tracks.append(seal_line(json.dumps(track | {"trial_id": name})) + "\n")
            left -= 1
    execution = as_dict(ExecutionConfig())
    session = {"started_at": "2026-01-01T00:00:00+00:00", "execution": execution}
    sessions = (session | provenance(),)
    replace(RunFile.for_run(path, config, []), sessions=sessions).write()
    (path / "results.jsonl").write_text("\n".join(lines) + "\n")
    (path / "tracks.jsonl").write_text("".join(tracks))
    return path
