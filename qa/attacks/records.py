"""Attacks on rivals, on records of trials and on their choice; see `attacks.py`."""

import resource
import secrets
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from forgery import edit_run
from inside import Loser, attack, describe_check, drive, drive_twice
from planners import Straight, run_inline
from report_work import rewrite_rows

import barn_eval as barn
from barn_eval.results.run_file import RunFile
from barn_eval.ros.isolation import ros_problem
from barn_eval.trials.protocol import PROTOCOLS
from barn_eval.trials.seeds import planner_seed
from barn_planners.interface import Decision, Task
from barn_worlds.base.config import as_dict
from barn_worlds.base.types import STOP
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file

_TRIED_SEEDS = 10_000
_COPIES = 12
# Settings of Fast DDS with which a process hears nobody.
_DEAF = """
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="deaf" is_default_profile="true">
    <rtps><useBuiltinTransports>false</useBuiltinTransports></rtps>
  </participant>
</profiles>
"""


class Vandal(Straight):  # type: ignore[misc]
    """Spoils what its rivals use in the same process, and notes what it gets itself."""

    obstacle_cells: list[int]

    def start(self, task: Task, seed: int) -> None:
        """Begin a trial."""
        super().start(task, seed)
        np.seterr(all="raise")
        assert task.map is not None
        self.obstacle_cells.append(int(np.count_nonzero(task.map.data)))
        task.map.data[:] = 0


class Learner(Loser):
    """Stops, in the second trial of a process, where the first one ended."""

    trials = 0

    def escape(self, decision: Decision) -> Decision:
        """Return a command that depends on the trials before."""
        Learner.trials += 1
        return replace(decision, command=STOP) if Learner.trials == 2 else decision


class Guesser(Straight):  # type: ignore[misc]
    """Looks for the seed of the run, from which that of the simulator follows."""

    seed = -1

    def start(self, task: Task, seed: int) -> None:
        """Begin a trial."""
        super().start(task, seed)
        for guess in range(_TRIED_SEEDS):
            if planner_seed(guess, 120, 0, "mine") == seed:
                Guesser.seed = guess


@attack("rival/process", "A planner clears its map, and makes rounding an exception.")
def _(out: Path) -> str:
    errors = np.geterr()
    Vandal.obstacle_cells = []
    choices: Any = {"mine": Vandal, "rival": Vandal}
    with np.errstate():
        run_inline("120", choices, PROTOCOLS["known_map"], out=out)
        is_spoiled = np.geterr() != errors
    mine, rival = Vandal.obstacle_cells
    return f"both have {rival} cells" if mine == rival and not is_spoiled else ""


@attack("rival/memory", "It remembers where its first trial in a world ended.")
def _(out: Path) -> str:
    drive(out, Learner, repetitions=2)
    choices: Any = {"mine": Learner}
    difference: str = barn.load(out, planners=choices).rerun(1)
    return difference


@attack("answer/seed", "It looks for the run's seed by its own seed.")
def _(out: Path) -> str:
    drive(out, Guesser)
    easy = Guesser.seed
    drive(out.with_name("secret"), Guesser, seed=secrets.randbits(62))
    return "" if Guesser.seed != easy else f"found {easy}, but no seed of 62 bits"


@attack("worlds/copies", "One world under many numbers counts as many worlds.")
def _(out: Path) -> str:
    path = out / "mine.npz"
    world = open_dataset("barn300").load(0)
    write_dataset_file(path, "mine", dict.fromkeys(range(_COPIES), world))
    drive(out / "run", Straight, "all", dataset=str(path))
    notes = barn.load(out / "run").verdict()
    return notes if "copies" in notes else ""


@attack("worlds/link", "A link to the worlds leads to harder ones after the trials.")
def _(out: Path) -> str:
    for number in (0, 120):
        world = open_dataset("barn300").load(number)
        write_dataset_file(out / f"{number}.npz", "mine", {120: world})
    link = out / "mine.npz"
    link.symlink_to(out / "0.npz")
    drive(out / "run", Straight, dataset=str(link))
    link.unlink()
    link.symlink_to(out / "120.npz")
    return describe_check(out / "run")


def claim(folder: Path, **changes: Any) -> str:
    """Change all rows of a folder and return what a check says of it."""
    rewrite_rows(folder, lambda rows: [row | changes for row in rows])
    return describe_check(folder)


@attack("folder/mode", "Rows claim ROS in real time, where nothing is driven again.")
def _(out: Path) -> str:
    drive(out, "gap")
    with edit_run(out) as content:
        content["experiment"]["mode"] = "ros"
        content["experiment"]["ros"]["lockstep"] = False
    (out / "commands.jsonl").unlink()
    return claim(out, mode="ros", compute="real_time")


@attack("folder/cap", "A lower speed cap is claimed, by which efficiency is higher.")
def _(out: Path) -> str:
    drive(out, Loser, settings={"mine.max_speed_mps": 0.5})
    with edit_run(out) as content:
        content["experiment"]["planners"][0]["max_speed_mps"] = 0.25
    (spec,) = RunFile.read(out).run_config().trials()
    scores = barn.load(out).trials[0].scores
    scores = replace(scores, least_time_s=spec.least_time_s, efficiency=0.0)
    changes = {"speed_cap_mps": 0.25, "planner_config": spec.planner_config}
    return claim(out, scores=as_dict(scores), **changes)


@attack("folder/merged", "A trial of another run takes the place of a lost one.")
def _(out: Path) -> str:
    drive(out, "gap", "0")
    other = drive(out.with_name("other"), "gap", "0", seed=6)
    for name in ("results", "tracks", "commands"):
        shutil.copy(other / f"{name}.jsonl", out)
    return describe_check(out)


@attack("again/options", "A run goes on with another way of charging.")
def _(out: Path) -> str:
    drive(out, Loser, repetitions=2, compute="measured")
    rewrite_rows(out, lambda rows: rows[:1])
    try:
        drive(out, Loser, repetitions=2)
    except barn.BarnError as error:
        return f"refused: {error}"
    return ""


def run_beside_shadows(folder: Path, *words: str) -> str:
    """Run barn where modules have names of those that it imports; return its output."""
    for name in ("barn_eval", "barn_sim", "numpy", "json", "sitecustomize"):
        (folder / f"{name}.py").write_text("raise SystemExit('shadowed')")
    # In a workspace, it is not beside Python.
    beside = Path(sys.executable).with_name("barn")
    ended = subprocess.run(
        [beside if beside.exists() else "barn", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    return "" if "shadowed" in ended.stdout + ended.stderr else ended.stdout


@attack("submission/shadow", "Modules beside results shadow those of the suite.")
def _(out: Path) -> str:
    drive(out / "run", "gap", "0,30")
    return run_beside_shadows(out, "check", "run")


@attack("planner/shadow", "Modules beside a planner shadow those of workers.")
def _(out: Path) -> str:
    words = ("--planner", "gap", "--worlds", "0,30", "--workers", "2")
    return run_beside_shadows(out, "run", *words, "--out", "run", "--json")


@attack("rival/profile", "It leaves settings of DDS where those after it start.")
def _(out: Path) -> str:
    if ros_problem():
        return f"not tried here: {ros_problem()}"
    (out / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(_DEAF)
    words = ("--planner", "gap", "--worlds", "0", "--mode", "ros")
    run_beside_shadows(out, "run", *words, "--out", "run")
    scores = barn.load(out / "run").trials[0].scores
    return "heard, and drives" if scores.success else ""


def starve(out: Path, limit: int) -> str:
    """Let a planner set a limit of its process, with which a run cannot go on."""

    class Starving(Loser):
        attempts = 0

        def escape(self, decision: Decision) -> Decision:
            Starving.attempts += 1
            if Starving.attempts == 1:
                resource.setrlimit(limit, (0, most))
            return decision

    usual, most = resource.getrlimit(limit)
    try:
        with suppress(barn.BarnError):
            drive(out, Starving)
    finally:
        resource.setrlimit(limit, (usual, most))
    return drive_twice(out, Starving)


@attack("again/disk", "A planner that loses lets nothing be written, and drives again.")
def _(out: Path) -> str:
    return starve(out, resource.RLIMIT_FSIZE)


@attack("again/files", "It lets no file be opened, and drives again.")
def _(out: Path) -> str:
    return starve(out, resource.RLIMIT_NOFILE)


@attack("name/protocol", "A protocol with more time has the name of the challenge.")
def _(out: Path) -> str:
    path = out / "challenge.yaml"
    path.write_text(
        "schema_version: 1\nbase: challenge\nname: challenge\nlimit_s: 200.0"
    )
    try:
        row = barn.run("120", "gap", str(path), out=out / "run").trials[0]
    except barn.BarnError as error:
        return f"refused: {error}"
    return "" if row.protocol == "challenge" else f"called {row.protocol}"


@attack("folder/table", "Only the table that others load is changed.")
def _(out: Path) -> str:
    drive(out, "gap", "0")
    path = out / "results.csv"
    path.write_text(path.read_text().replace("success", "faster", 1))
    return next(iter(barn.results.check(out).problems), "")
