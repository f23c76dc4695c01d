"""A trial judged again: by what was recorded of it, and by driving its recorded commands again without its planner."""

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.decode import metadata
from barn_eval.results.tracks import Track, make_track, unpack_arrays
from barn_eval.running.pool import Emit, Work
from barn_eval.trials.identity import first_difference
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import REAL_TIME, TrialResult, unpack_delays
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Trajectory
from barn_eval.trials.trial import RunningTrial
from barn_eval.verification.plausibility import (
    JUDGED,
    ROUNDING,
    computed,
    difference,
    off_track,
    unreasonable,
)
from barn_sim.contact.bullet import PhysicsClient
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import NO_COMPUTE, CycleTimer
from barn_worlds.base.errors import BarnError
from barn_worlds.base.text_files import parse_json
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Odometry,
    Pose2D,
    Velocity2D,
    nanoseconds,
)
from barn_worlds.messages import decode
from barn_worlds.messages.topics import CMD_VEL, COLLISION, GROUND_TRUTH, ODOM, SCAN
from barn_worlds.robots.contact import contact_footprint

COMMANDS_NAME = "commands.jsonl"  # of a submission: what planners commanded
_MOST_BYTES = 16_000_000  # of the commands of a trial, a million
_NO_COMMAND = (math.nan, math.nan)


class Driven(NamedTuple):
    """What was measured and commanded in a trial: a trajectory, and measured poses (n, 3) in the odom frame.

    exact: whether each command is known to have been the only one that answered its scan, and in time.
    """

    trajectory: Trajectory
    odometry: Floats
    exact: bool = True


class TrialEvidence(NamedTuple):
    """What a folder has of a trial.

    bag: its folder, None without one. commands: a line of a submission. drive: whether they are to be driven again.
    """

    row: TrialResult
    spec: TrialSpec
    track: Track | None
    bag: Path | None = None
    commands: str = ""
    drive: bool = True


class TrialCheck(NamedTuple):
    """What there is to say of a trial, and of its bag: what is wrong, what could not be checked, and what was done."""

    trial_id: str
    problems: tuple[str, ...] = ()
    of_bag: tuple[str, ...] = ()
    unchecked: str = ""
    bag: bool = False
    driven: bool = False


class CheckWork(Work):
    """What a worker does with trials of a folder that are to be checked."""

    loads = False

    def run(self, job: Sequence[TrialEvidence], emit: Emit) -> None:
        """Tell what there is to say of each of the trials of a job, by its name."""
        for one in job:
            emit((one.row.trial_id, checked(one)))


@dataclass
class _Instant:
    odometry: Odometry
    truth: Odometry
    contact: bool = False
    commands: tuple[tuple[float, float], ...] = ()
    scanned: bool = False


def read_bag(bag: BagFile) -> tuple[Driven, int]:
    """Return what a bag has of a trial, and how many messages: the true pose follows the odometry of its instant."""
    instants: list[_Instant] = []
    odometry, count = None, 0
    for message in bag.messages():
        count += 1
        if message.topic == ODOM.path:
            odometry = decode.odometry(message.data)
        elif message.topic == GROUND_TRUTH.path and odometry is not None:
            instants.append(_Instant(odometry, decode.odometry(message.data)))
        elif not instants:
            continue
        elif message.topic == COLLISION.path:
            instants[-1].contact |= decode.boolean(message.data)
        elif message.topic == SCAN.path:
            instants[-1].scanned = True
        elif message.topic == CMD_VEL.path:
            command = decode.command(message.data, message.type_name)
            instants[-1].commands += ((command.linear, command.angular),)
    return _driven(instants), count


def _driven(instants: Sequence[_Instant]) -> Driven:
    rows = [
        (
            *_place(one.odometry),
            *_place(one.truth),
            one.truth.velocity.linear,
            one.truth.velocity.angular,
        )
        for one in instants
    ]
    readings = np.array(rows, np.float64).reshape(-1, 8)
    stamps = np.array([one.truth.stamp_ns for one in instants], np.int64)
    commands = np.array(
        [(one.commands or (_NO_COMMAND,))[-1] for one in instants], np.float64
    ).reshape(-1, 2)
    contact = np.array([one.contact for one in instants], np.bool_)
    exact = all(len(one.commands) == one.scanned for one in instants[:-1])
    measured = Trajectory(
        stamps - stamps[:1], readings[:, 3:6], readings[:, 6:], commands, contact
    )
    return Driven(measured, readings[:, :3], exact)


def _place(odometry: Odometry) -> tuple[float, float, float]:
    return odometry.pose.x, odometry.pose.y, odometry.pose.yaw


@cache
def _engine() -> PhysicsClient:
    """Return the engine of all trials of this process, one after the other."""
    return PhysicsClient()


def driven_again(spec: TrialSpec, commands: Floats) -> Driven:
    """Return what a robot does that is commanded so, (n, 2), instant by instant; NaN: not at all.

    Scans and the pose on the map are not made: they have noise of their own, and nothing here depends on them.
    """
    config, instants = spec.simulator, []
    cycle_timer = CycleTimer(spec.compute, spec.planner_seed, spec.recorded_ns)
    scan_ns = config.scan_steps * nanoseconds(config.control_period_s)
    with closing(
        Simulator(spec.world, config, spec.course.start, spec.simulator_seed, _engine())
    ) as simulator:
        for command in commands.tolist():
            stamp_ns = simulator.stamp_ns
            instants.append(
                _Instant(
                    simulator.read_odometry(),
                    simulator.read_truth(),
                    simulator.read_collision(),
                )
            )
            asked = not stamp_ns % scan_ns and cycle_timer.is_free(stamp_ns)
            delay_ns = cycle_timer.start_cycle(stamp_ns) if asked else 0
            if not math.isnan(command[0]):
                instants[-1].commands = ((command[0], command[1]),)
                simulator.command(Velocity2D(*command), delay_ns)
            simulator.advance(config.ticks(config.control_period_s))
    return _driven(instants)


def judged(
    row: TrialResult, spec: TrialSpec, driven: Driven
) -> tuple[TrialResult, Trajectory]:
    """Return the row that readings and commands give, and the trajectory; BarnError if they do not end the trial.

    What no reading shows, such as a planner that died, is taken from the row: it has to come before any verdict.
    """
    trial, there = RunningTrial(spec), driven.trajectory
    columns = (
        there.stamps_ns,
        driven.odometry,
        there.truth,
        there.velocity,
        there.contact,
        there.command,
    )
    for stamp, odometry, truth, velocity, contact, command in zip(
        *(one.tolist() for one in columns), strict=True
    ):
        moved = Velocity2D(*velocity)
        trial.read(
            Odometry(stamp, Pose2D(*odometry), moved),
            Odometry(stamp, Pose2D(*truth), moved),
            contact,
        )
        if not math.isnan(command[0]) and trial.verdict is None:
            trial.command(Velocity2D(*command))
    if trial.verdict is None and row.outcome in JUDGED:
        raise BarnError(
            f"outcome is {row.outcome.value} in the row, but its readings do not end the trial"
        )
    verdict = trial.verdict or trial.referee.fail(row.outcome, row.detail, row.fault)
    if row.outcome is Outcome.INTERFERENCE:  # takes the place of any verdict
        verdict = replace(verdict, outcome=row.outcome, detail=row.detail, culprit="")
    elif row.detail.startswith(verdict.detail):  # what the planner says of it is added
        verdict = replace(verdict, detail=row.detail)
    trajectory = trial.log.trajectory()
    return computed(row, spec, verdict, trajectory), trajectory


def checked(recorded: TrialEvidence) -> TrialCheck:
    """Return what there is to say of a trial."""
    row, spec, bag = recorded.row, recorded.spec, None
    if not row.planner_config:  # a planner that was started by hand
        spec = replace(
            spec,
            planner_config="",
            preset=row.preset,
            declared_mps=0.0,
            compute=NO_COMPUTE,
            compute_mode=row.compute,
        )
    elif not spec.planner_config:  # one that is not installed here
        spec = replace(
            spec,
            planner_config=row.planner_config,
            preset=row.preset,
            declared_mps=row.speed_cap_mps or 0.0,
        )
    if row.delays:
        spec = replace(spec, recorded_ns=unpack_delays(row.delays))
    problems = [*unreasonable(row, spec), *off_track(row, spec, recorded.track)]
    driven, unchecked, again = None, "", False
    if recorded.bag is not None:
        bag = BagFile(recorded.bag)
        driven, count = read_bag(bag)
        if bag.problem or (not count and row.measures.driven_m > 0.0):
            return TrialCheck(
                row.trial_id,
                tuple(problems),
                (bag.problem or "the bag is empty",),
                bag=True,
            )
        written = metadata(bag, "barn.result", "result")
        if (
            written
            and (other := first_difference(row.repeatable(), written)) is not None
        ):
            problems.append(
                f"{other[0]} is {other[1]!r} in the row, {other[2]!r} in the bag"
            )
    unchecked = _undrivable(row, driven, recorded.commands)
    again = recorded.drive and not unchecked
    unchecked = unchecked or (
        ""
        if row.planner_config
        else "parameters and speed cap are not known of their planner"
    )
    try:
        simulated = (
            driven_again(
                spec, driven.trajectory.command if driven else _commands(recorded)
            )
            if again
            else None
        )
        if driven is not None and simulated is not None:
            problems += _off(driven, simulated)
        if (readings := driven or simulated) is not None:
            problems += _misjudged(row, spec, readings, recorded.track)
    except BarnError as error:
        problems.append(str(error))
    return TrialCheck(
        row.trial_id,
        tuple(dict.fromkeys(problems)),
        (),
        unchecked,
        bag is not None,
        again,
    )


def _undrivable(row: TrialResult, driven: Driven | None, commands: str) -> str:
    """Return why the commands of a trial cannot be driven again, empty if they can."""
    if not row.is_scored:
        return "not driven again, as they are not scored"
    if driven is None and not commands:
        return "not driven again, as their commands are not kept (--bags all keeps them); only tracks tell of them"
    if row.compute == REAL_TIME or (
        row.mode == "ros" and driven is not None and not driven.exact
    ):
        return "not driven again, as commands outside lockstep, late, or several to a scan took effect at times unknown"
    return ""


def _commands(recorded: TrialEvidence) -> Floats:
    return unpack_arrays(
        parse_json(recorded.commands, recorded.row.trial_id), _MOST_BYTES
    )["commands"].reshape(-1, 2)


def _off(driven: Driven, simulated: Driven) -> Iterator[str]:
    """Yield how what was recorded is not what the recorded commands give."""
    there, here = (
        np.column_stack(
            [
                one.stamps_ns / NANOSECONDS_PER_SECOND,
                one.truth,
                odometry,
                one.velocity,
                one.contact,
            ]
        )
        for one, odometry, _ in (driven, simulated)
    )
    off = np.abs(there - here)
    off[:, [3, 6]] = np.minimum(off[:, [3, 6]], np.abs(2.0 * np.pi - off[:, [3, 6]]))
    if len(found := np.flatnonzero(~(off.max(axis=1, initial=0.0) <= ROUNDING))):
        at, far_m = here[found[0], 0], np.nanmax(off[:, 1:3])
        yield f"its commands, driven again, give another trajectory from {at:.2f} s on, up to {far_m:.3g} m away"


def _misjudged(
    row: TrialResult, spec: TrialSpec, readings: Driven, track: Track | None
) -> Iterator[str]:
    """Yield what of a row and its track does not follow from its readings."""
    again, trajectory = judged(row, spec, readings)
    if told := difference(row, again):
        yield told
    world = spec.world
    made = make_track(
        trajectory,
        world.cylinders_m,
        world.cylinder_radius_m,
        contact_footprint(spec.simulator.chassis),
    )
    if track is None or made is None:
        return
    same = made.samples.shape == track.samples.shape and np.array_equal(
        made.contact, track.contact
    )
    if not same or not np.allclose(
        made.samples, track.samples, rtol=0.0, atol=track.steps, equal_nan=True
    ):
        yield "its track is not that of its readings"
