"""Judge a trial again: by its recorded readings, and by driving its commands again."""

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.decode import metadata
from barn_eval.results.commands import (
    PlannerCycles,
    parse_commands_line,
    requires_commands,
)
from barn_eval.results.tracks import Track, make_track
from barn_eval.running.direct import run_direct_trial
from barn_eval.running.pool import Emit, Work
from barn_eval.trials.result import (
    REAL_TIME,
    SCHEMA_VERSION,
    Outcome,
    TrialResult,
    unpack_delays,
)
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Trajectory, TrajectoryLog
from barn_eval.trials.trial import RunningTrial
from barn_eval.verification.plausibility import (
    JUDGED_OUTCOMES,
    ROUNDING,
    compare_with_track,
    find_difference,
    find_implausible_values,
    find_rescoring_difference,
    recompute_row,
)
from barn_sim.contact.scene import ScenePool
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import NO_COMPUTE
from barn_worlds.base.errors import BarnError, ConfigError, TippedError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Odometry, Pose2D, Velocity2D
from barn_worlds.messages import decode
from barn_worlds.messages.topics import CMD_VEL, COLLISION, GROUND_TRUTH, ODOM, SCAN

# Physics clients for all trials of this process; new ones would give the same results.
_scenes = ScenePool()

_pose_row = attrgetter("x", "y", "yaw")


class Readings(NamedTuple):
    """Measurements and commands of a trial."""

    trajectory: Trajectory  # with stamps relative to its first reading
    odometry: Floats  # (n, 3) measured poses in the odom frame
    # Whether each command was the only one that answered its scan, and in time.
    is_exact: bool = True
    # Whether the robot tipped over after the last command.
    is_tipped: bool = False


@dataclass(frozen=True)
class TrialEvidence:
    """A trial, and what a folder holds of it."""

    row: TrialResult
    spec: TrialSpec
    track: Track | None
    bag: Path | None
    commands: str  # line of the commands; empty if there is none
    drive: bool  # whether to drive them again


@dataclass
class TrialCheck:
    """Problems of a trial."""

    trial_id: str
    problems: list[str] = field(default_factory=list)  # whichever version drove it
    # From what this version computes.
    differences: list[str] = field(default_factory=list)
    bag_problem: str = ""  # why its bag cannot be read to its end
    unchecked: str = ""  # why something could not be checked
    was_driven: bool = False


class CheckWork(Work):
    """The work of a worker process that checks trials."""

    # Checks run no code but that of the suite.
    needs_import_path = False

    def run(self, job: TrialEvidence, emit: Emit) -> TrialCheck:  # noqa: ARG002
        """Check a trial and return its check; `emit` is not used."""
        return check_trial(job)


def read_bag(bag: BagFile) -> Readings:
    """Return a bag's true poses, odometry, contacts and commands, up to any damage.

    Within an instant, the true pose follows the odometry; contact, scan and command
    follow the true pose.
    """
    log = TrajectoryLog()
    odometry: list[tuple[float, ...]] = []
    contacts: list[bool] = []
    scanned: list[bool] = []
    measured: Odometry | None = None
    for message in bag.messages():
        topic = message.topic
        if topic == ODOM.path:
            measured = decode.odometry(message.data)
        elif topic == GROUND_TRUTH.path and measured is not None:
            log.reading(decode.odometry(message.data), collision=False)
            odometry.append(_pose_row(measured.pose))
            contacts.append(False)
            scanned.append(False)
        elif not odometry:
            continue
        elif topic == COLLISION.path:
            # There may be several messages to a reading: a contact in any of them
            # counts.
            contacts[-1] |= decode.boolean(message.data)
        elif topic == SCAN.path:
            scanned[-1] = True
        elif topic == CMD_VEL.path:
            log.command(decode.command(message.data, message.type_name))

    recorded = log.trajectory()
    stamps_ns = recorded.stamps_ns
    trajectory = replace(
        recorded,
        stamps_ns=stamps_ns - stamps_ns[:1],
        contact=np.array(contacts, np.bool_),
    )
    is_exact = np.array_equal(recorded.command_counts[:-1], scanned[:-1])
    return Readings(trajectory, _pose_table(odometry), is_exact)


def _pose_table(poses: Sequence[tuple[float, ...]]) -> Floats:
    """Return poses (x, y [m], yaw [rad]) as an array (n, 3), where n may be 0."""
    # An array of no poses has no second axis.
    return np.array(poses, np.float64).reshape(-1, 3)


def drive_again(spec: TrialSpec, commands: Floats) -> Readings:
    """Simulate a trial by its commands; return readings; ConfigError if one is not due.

    Scans and the pose on the map are not simulated: they have noise of their own, and
    nothing here depends on them.

    Args:
        spec: The trial.
        commands: Command (n, 2) of each instant in m/s and rad/s, NaN for none.

    Raises:
        ConfigError: If there is a command at an instant when the planner was not asked.
        TippedError: If the robot tips over before the last command.
    """
    config = spec.simulator
    cycles = PlannerCycles(spec)
    log = TrajectoryLog()
    odometry = []
    is_tipped = False
    start = spec.course.start
    with closing(
        Simulator(spec.world, config, start, spec.simulator_seed, _scenes)
    ) as simulator:
        for linear, angular in commands.tolist():
            stamp_ns = simulator.stamp_ns
            odometry.append(_pose_row(simulator.read_odometry().pose))
            log.reading(simulator.read_truth(), simulator.read_collision())
            delay_ns = cycles.start(stamp_ns)
            if not math.isnan(linear):
                # A command during declared computing time would come too early. The
                # last reading ends the trial.
                if delay_ns is None and len(odometry) < len(commands):
                    raise ConfigError(
                        f"has a command at {stamp_ns / NANOSECONDS_PER_SECOND:.2f} s,"
                        " when none was due"
                    )
                command = Velocity2D(linear, angular)
                log.command(command)
                simulator.command(command, delay_ns or 0)
            try:
                simulator.advance(config.ticks(config.control_period_s))
                simulator.require_upright()
            except TippedError:
                if len(odometry) < len(commands):
                    raise
                is_tipped = True

    return Readings(log.trajectory(), _pose_table(odometry), is_tipped=is_tipped)


def drive_by_planner(spec: TrialSpec, row: TrialResult) -> str:
    """Drive a trial directly with its planner; return how its row differs, or "".

    Args:
        spec: The trial.
        row: Its row, of either mode.
    """
    content = run_direct_trial(_with_planner_of_row(spec, row)).result.repeatable()
    ignored: tuple[str, ...] = ("schema_version",)
    if row.mode == "ros":
        # Over ROS, these come from messages.
        ignored += ("mode", "remarks", "recoveries", "planner_verdict")
    difference = find_difference(
        row, content, "driven by the planner", ROUNDING, ignored
    )
    return next(difference, "")


def replay_trial(spec: TrialSpec, readings: Readings) -> RunningTrial:
    """Judge readings and commands anew; return the trial, maybe without a verdict.

    It has none if the readings do not end it.

    Args:
        spec: The trial.
        readings: Measurements and commands.
    """
    trial = RunningTrial(spec)
    trajectory = readings.trajectory
    instants = zip(
        trajectory.stamps_ns.tolist(),
        readings.odometry.tolist(),
        trajectory.truth.tolist(),
        trajectory.velocity.tolist(),
        trajectory.contact.tolist(),
        trajectory.command.tolist(),
        strict=True,
    )
    for stamp_ns, measured_pose, true_pose, twist, is_contact, answer in instants:
        velocity = Velocity2D(*twist)
        measured = Odometry(stamp_ns, Pose2D(*measured_pose), velocity)
        truth = Odometry(stamp_ns, Pose2D(*true_pose), velocity)
        trial.read(measured, truth, is_contact)
        command = Velocity2D(*answer)
        # Over ROS, commands may arrive after the verdict, without any effect.
        if not math.isnan(command.linear) and trial.verdict is None:
            trial.command(command)
    return trial


def check_trial(evidence: TrialEvidence) -> TrialCheck:
    """Check a trial's row against track and bag; drive its commands again if asked."""
    row = evidence.row
    spec = _with_planner_of_row(evidence.spec, row)
    check = TrialCheck(row.trial_id)
    check.problems += find_implausible_values(row, spec)
    check.problems += compare_with_track(row, spec, evidence.track)
    check.differences += find_rescoring_difference(row, spec)

    recorded = None
    if evidence.bag is not None:
        bag = BagFile(evidence.bag)
        recorded = read_bag(bag)
        if bag.problem or (bag.is_empty and row.measures.driven_m > 0.0):
            check.bag_problem = bag.problem or "the bag is empty"
            return check
        bag_row = metadata(bag, "barn.result", "result")
        if bag_row:
            # An older bag may lack keys that reading the row has added.
            check.differences += find_difference(row, bag_row, "in the bag")
    # Older folders have commands only in bags.
    if not evidence.commands and is_current(row) and requires_commands(row, spec):
        check.problems.append("its commands are missing")

    try:
        _check_readings(check, evidence, spec, recorded)
    except BarnError as error:
        check.problems.append(str(error))
    # Two comparisons may find the same difference.
    check.differences = list(dict.fromkeys(check.differences))
    if not check.unchecked and not row.planner_config:
        check.unchecked = "parameters and speed cap of their planner are unknown"
    return check


def _check_readings(
    check: TrialCheck,
    evidence: TrialEvidence,
    spec: TrialSpec,
    recorded: Readings | None,
) -> None:
    """Drive commands again if possible; add to `check` what differs from row and bag.

    Args:
        check: The check so far.
        evidence: What the folder holds of the trial.
        spec: The trial.
        recorded: Readings of its bag, if there is one.

    Raises:
        BarnError: If the commands cannot be read or driven.
    """
    row = evidence.row
    commands = _find_commands(evidence, recorded)
    check.unchecked = _why_not_driven(row, recorded, commands)
    simulated = None
    if commands is not None and evidence.drive and not check.unchecked:
        simulated = drive_again(spec, commands)
        check.was_driven = True
        check.differences += _compare_drives(row, recorded, simulated)
        if recorded is not None:
            check.problems += _compare_commands(recorded, simulated)
    readings = recorded or simulated
    # Poses of an observed trial are in a frame of their own.
    if readings is not None and row.observed is None:
        check.differences += _judge(row, spec, readings, evidence.track)


def _with_planner_of_row(spec: TrialSpec, row: TrialResult) -> TrialSpec:
    """Return the trial with its row's delays, and planner data if either has none."""
    if row.delays:
        spec = replace(spec, recorded_ns=unpack_delays(row.delays))
    if not row.planner_config:  # a planner that was started by hand
        return replace(
            spec,
            planner_config="",
            preset=row.preset,
            declared_mps=0.0,
            compute=NO_COMPUTE,
            compute_mode=row.compute,
        )
    if not spec.planner_config:  # a planner that is not installed here
        return replace(
            spec,
            planner_config=row.planner_config,
            preset=row.preset,
            declared_mps=row.speed_cap_mps or 0.0,
        )
    return spec


def is_current(row: TrialResult) -> bool:
    """Return whether a row is of the schema that this version writes."""
    return row.schema_version == SCHEMA_VERSION


def _find_commands(evidence: TrialEvidence, recorded: Readings | None) -> Floats | None:
    """Return a trial's commands (n, 2) from its line, else an exact bag, else None."""
    if evidence.commands:
        _, commands = parse_commands_line(evidence.commands, "its commands")
        return commands

    # Folders of earlier versions have commands only in bags.
    if recorded is None or (evidence.row.mode == "ros" and not recorded.is_exact):
        return None
    return recorded.trajectory.command


def _why_not_driven(
    row: TrialResult, recorded: Readings | None, commands: Floats | None
) -> str:
    """Return why a trial's commands cannot be driven again, or "" if they can."""
    if row.observed is not None:
        return f"observed, not driven again ({row.observed.system})"
    # A trial that is not scored did not end by its readings.
    if not row.is_scored and commands is None:
        return "not driven again, because they are not scored"
    is_inexact = row.mode == "ros" and (recorded is not None or is_current(row))
    if row.compute == REAL_TIME or (commands is None and is_inexact):
        return (
            "not driven again, because commands outside lockstep, late, or several to a"
            " scan took effect at unknown times"
        )
    if commands is None:
        return (
            "not driven again, because their commands are missing; only tracks show"
            " them"
        )
    return ""


def _compare_commands(recorded: Readings, simulated: Readings) -> Iterator[str]:
    """Yield a text if the commands in the bag and those driven again differ."""
    command = recorded.trajectory.command
    if not np.array_equal(command, simulated.trajectory.command, equal_nan=True):
        yield "its commands differ from those in its bag"


def _compare_drives(
    row: TrialResult, recorded: Readings | None, simulated: Readings
) -> Iterator[str]:
    """Yield texts on a tip not repeated, and on where readings first differ."""
    if row.outcome is Outcome.ROBOT_TIPPED and not simulated.is_tipped:
        yield "its commands, driven again, do not tip the robot over"
    # After other commands, readings differ in any case.
    if recorded is None or any(_compare_commands(recorded, simulated)):
        return
    difference = np.abs(_reading_table(recorded) - _reading_table(simulated))
    yaws = difference[:, [3, 6]]
    # Two nearly equal angles may lie on either side of pi.
    difference[:, [3, 6]] = np.minimum(yaws, np.abs(2.0 * np.pi - yaws))
    # Not "greater", so that NaN counts as a difference.
    is_off = ~(difference.max(axis=1, initial=0.0) <= ROUNDING)
    if is_off.any():
        stamp_ns = simulated.trajectory.stamps_ns[np.flatnonzero(is_off)[0]]
        distance_m = np.nanmax(difference[:, 1:3])
        yield (
            "its commands, driven again, give a different trajectory from"
            f" {stamp_ns / NANOSECONDS_PER_SECOND:.2f} s on, up to {distance_m:.3g} m"
            " away"
        )


def _reading_table(readings: Readings) -> Floats:
    """Return readings (n, 10): time [s], true pose, odometry, speed, yaw rate, contact."""
    trajectory = readings.trajectory
    columns = [
        trajectory.stamps_ns / NANOSECONDS_PER_SECOND,
        trajectory.truth,
        readings.odometry,
        trajectory.velocity,
        trajectory.contact,
    ]
    return np.column_stack(columns)


def _judge(
    row: TrialResult, spec: TrialSpec, readings: Readings, track: Track | None
) -> Iterator[str]:
    """Judge readings again; yield differences of the row and the track from the result.

    An end that no reading shows, such as that of a planner that died, is taken from the
    row, unless the readings give a verdict.
    """
    trial = replay_trial(spec, readings)
    if trial.verdict is None and row.outcome in JUDGED_OUTCOMES:
        yield (
            f"outcome is {row.outcome.value} in the row, but the readings do not end"
            " the trial"
        )
        return
    verdict = trial.verdict or trial.referee.fail(row.outcome, row.detail, row.fault)
    if row.outcome is Outcome.INTERFERENCE:
        # Interference replaces any verdict.
        verdict = replace(verdict, outcome=row.outcome, detail=row.detail, culprit="")
    elif row.detail.startswith(verdict.detail):
        # The row appends what the planner says about the trial.
        verdict = replace(verdict, detail=row.detail)
    trajectory = trial.log.trajectory()
    recomputed = recompute_row(row, spec, verdict, trajectory).repeatable()

    # The distance from plans depends on what a planner says.
    ignored = ("measures.off_plan_m",)
    yield from find_difference(row, recomputed, "computed again", ROUNDING, ignored)
    expected = make_track(trajectory, spec)
    if track is None or expected is None:
        return
    samples = expected.samples
    is_same = (
        # Another processor may round to the next step.
        samples.shape == track.samples.shape
        and np.array_equal(expected.contact, track.contact)
        and np.allclose(
            samples, track.samples, rtol=0.0, atol=track.steps, equal_nan=True
        )
    )
    if not is_same:
        yield "its track does not follow from its readings"
