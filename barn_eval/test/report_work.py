"""A campaign for tests of pages: one trial that was driven, its bag, and rows of many others made from it."""

import json
import shutil
from dataclasses import replace

import numpy as np
from rich.console import Console

from barn_eval.bags.recorded import read_recorded
from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
from barn_eval.experiments.folder import read_results
from barn_eval.experiments.request import Request
from barn_eval.experiments.rows import TrackRows, sealed, unsealed
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.run_file import RunFile, provenance
from barn_eval.experiments.track import thinned
from barn_eval.trials import identity
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import to_json_line, trial_id
from barn_eval.trials.spec import simulator_config
from barn_eval.trials.trajectory import clearances
from barn_worlds.base.config import as_dict
from barn_worlds.geometry.footprint import contact_of
from barn_worlds.worlds.dataset import open_dataset

EVIL = "</script><script>window.evil=1</script>"


def rewrite_rows(folder, change):
    """Write the rows of a folder again, as `change` makes them of what they were, with checksums that are right."""
    path = folder / "results.jsonl"
    rows = change([json.loads(unsealed(line, path.name)) for line in path.read_text().splitlines()])
    path.write_text("".join(f"{sealed(json.dumps(row))}\n" for row in rows))
    return rows


def recorded_track(bag, world):
    """The track of a trial as its bag has it."""
    recorded = read_recorded(bag)
    gaps = clearances(recorded.poses, world.cylinders_m, world.cylinder_radius_m, contact_of())
    samples = [recorded.times_s, recorded.poses, recorded.speeds, recorded.commands, gaps]
    return thinned(np.column_stack(samples), recorded.contact)


def dataset_of(protocol):
    """The name of the data set whose worlds a protocol is made for."""
    return "dynabarn60" if protocol.arena else "barn300"


def drive(path, protocol=CHALLENGE):
    """Drive one trial and return its folder."""
    rules = {"dataset": dataset_of(protocol), "protocol": protocol, "simulator": simulator_config(protocol)}
    experiment = Experiment(worlds="0", planners=(PlannerChoice("gap"),), seed=5, bags="all", **rules)
    run_experiment(Request(experiment, Execution(engine="inline"), path), Console(quiet=True))
    return path


def campaign(path, run, planners=("gap", "dwa"), worlds=8, repetitions=2, bags=3, faster=0.3, protocol=CHALLENGE):
    """Write a campaign of rows: the second planner is slower, every fifth trial fails; some have track and bag."""
    (model,) = read_results(run)
    simulator = simulator_config(protocol)
    task = identity.fingerprint(identity.task(protocol, simulator))
    dataset = open_dataset(dataset_of(protocol))
    path.mkdir()
    track = json.loads(next(iter(TrackRows(run).read().values())))
    lines, tracks, left = [], [], bags
    for world in range(worlds):
        checksum = dataset.load(world).checksum
        for repetition in range(repetitions):
            for place, planner in enumerate(planners):
                name = trial_id(planner, world, repetition)
                fails = (world + repetition) % 5 == 4
                time_s = 10.0 + world + 0.1 * repetition + faster * place
                scores = replace(
                    model.scores,
                    success=not fails,
                    traversal_time_s=50.0 if fails else time_s,
                    normalised_time_s_per_m=10.0 if fails else time_s / 5.0,
                    challenge=0.0 if fails else 2.0 / time_s,
                )
                row = replace(
                    model,
                    trial_id=name,
                    world=world,
                    world_name=EVIL,
                    world_checksum=checksum,
                    planner=planner,
                    protocol=protocol.name,
                    metric=protocol.metric,
                    task=task,
                    repetition=repetition,
                    simulator_seed=100 * world + repetition,
                    outcome=Outcome.TIMEOUT if fails else Outcome.SUCCESS,
                    detail=EVIL if fails else "",
                    scores=scores,
                )
                lines.append(sealed(to_json_line(row)))
                if left and world == 0:
                    shutil.copytree(run / "bags" / model.trial_id, path / "bags" / name)
                    tracks.append(sealed(json.dumps(track | {"trial_id": name})) + "\n")
                    left -= 1
    experiment = Experiment(
        dataset=dataset_of(protocol),
        worlds=f"0:{worlds}",
        planners=tuple(PlannerChoice(name) for name in planners),
        repetitions=repetitions,
        protocol=protocol,
        simulator=simulator,
        seed=5,
        bags="all" if bags else "none",
    )
    session = {"started_at": "2026-01-01T00:00:00+00:00", "execution": as_dict(Execution())} | provenance()
    replace(RunFile.of(path, experiment, {}), sessions=(session,)).write()
    (path / "results.jsonl").write_text("\n".join(lines) + "\n")
    (path / "tracks.jsonl").write_text("".join(tracks))
    return path
