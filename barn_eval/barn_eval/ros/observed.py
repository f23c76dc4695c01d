"""A simulator or robot that somebody else runs, in place of the suite's simulator.

Every reading of its pose is a tick. Where its odometry begins, and by which clock its
messages are stamped, does not matter: poses count from where the robot stands when the
trial begins, and times by differences of stamps.
"""

import math
import os
import select
import sys
import time
from dataclasses import replace
from importlib import import_module
from types import ModuleType
from typing import Any

from std_srvs.srv import Trigger

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.evaluator_loop import EvaluatorLoop, TrialEnded
from barn_eval.ros.remote_node import RemoteNode, ServiceRefused, ServiceTimeout
from barn_eval.ros.sequencer import Message
from barn_eval.ros.subscriber import Subscriber, TrialQueue
from barn_eval.trials.result import SIMULATOR, Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.stamps import StampSeries
from barn_eval.trials.system import OPERATOR
from barn_eval.trials.system_file import INTERFACES, SystemFile
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import ORIGIN, Odometry, Pose2D, seconds
from barn_worlds.messages import decode
from barn_worlds.messages.encode import place

_FARTHEST_START_M = 0.5
_OPERATOR_LIMIT_S = 24 * 3600.0
_RESULT_OK = 1  # of simulation_interfaces/msg/Result
# What the operator may say, by a key with its first letter or a service.
_CALLS = {
    "start": "starts the trial",
    "contact": "reports a contact",
    "abort": "aborts the trial",
}


class ObservedTopics(TrialTopics):
    """Topics of a system, which any of its nodes may publish."""

    of_simulator = ()


class ObservedSystem:
    """Has a system put the robot at the start, and converts its poses."""

    def __init__(
        self,
        loop: EvaluatorLoop,
        file: SystemFile,
        config: EvaluatorConfig,
        subscriber: Subscriber,
        topics: TrialTopics,
    ):
        """Offer ~/start, ~/contact and ~/abort, and listen to keys; wait for nothing.

        Args:
            loop: Spends the time of waits.
            file: The system.
            config: Limits of waits, and robot and data set of all trials.
            subscriber: Brings the poses.
            topics: Their topic, among others.

        Raises:
            ConfigError: If the reset needs a package that is not installed.
        """
        self.file = file
        self._loop = loop
        self._config = config
        self._subscriber = subscriber
        self._topics = topics
        self._calls: set[str] = set()
        # Which calls count now.
        self._allowed: tuple[str, ...] = ()
        # The pose of the trial's start in the frame of the system's poses.
        self.origin: Pose2D | None = None
        self._start = ORIGIN
        self._interfaces: ModuleType | None = None
        if file.reset == INTERFACES:
            self._interfaces = load_interfaces()
        for name in _CALLS:
            loop.node.create_service(Trigger, f"~/{name}", self._answer(name))
        self._has_keys = sys.stdin.isatty()
        if self._has_keys:
            loop.poll = self._read_keys

    def prepare(self, spec: TrialSpec, start_limit_s: float) -> int:
        """Have the robot put at its start, set `origin`; return time [ns]; or raise.

        Args:
            spec: The trial.
            start_limit_s: Longest wait for a service to be there.

        Returns:
            Wall-clock time in ns before which messages are not of the trial.

        Raises:
            TrialEnded: If there are no poses, or the robot is not at the start.
            BarnError: If a service refuses.
        """
        self._start = spec.course.start
        self._reset(spec, start_limit_s)
        self._allow("contact", "abort")
        if self._has_keys or self.file.reset == OPERATOR:
            self._loop.note(f"{spec.trial_id}: {self._describe_calls()}")
        reset_ns = time.time_ns()
        pose = self._loop.wait(lambda: self._read_pose(reset_ns), start_limit_s)
        if pose is None:
            raise TrialEnded(
                Outcome.ENVIRONMENT_FAILED,
                f"no pose on {self._topics.odometry} within {start_limit_s:g} s",
            )
        self.origin = pose
        if self.file.frame == "world":
            self.origin = self._start
            away_m = pose.distance(self._start)
            if away_m > _FARTHEST_START_M:
                raise TrialEnded(
                    Outcome.ENVIRONMENT_FAILED,
                    f"{self._topics.odometry} shows the robot {away_m:.2f} m from the"
                    " start; put it there, or set frame to odom",
                )
        return reset_ns

    def convert_pose(self, odometry: Odometry) -> tuple[Odometry, Odometry]:
        """Return a reading twice: its pose relative to the start, and in the map."""
        if self.origin is not None:
            pose = self.origin.inverse() @ odometry.pose
            odometry = replace(odometry, pose=pose)
        return odometry, replace(odometry, pose=self._start @ odometry.pose)

    def take_contact(self) -> bool:
        """Return whether a contact was reported; forget it; or TrialEnded by abort."""
        if "abort" in self._calls:
            raise TrialEnded(
                Outcome.ENVIRONMENT_FAILED, "the operator aborted the trial"
            )
        is_told = "contact" in self._calls
        self._calls.discard("contact")
        return is_told

    def await_connections(self, *_: int) -> bool:
        """Return True: a system does not tell who is connected."""
        return True

    def release(self) -> None:
        """Do nothing: time passes in a system in any case."""

    def pause(self) -> dict[str, int]:
        """Ignore the operator's calls from now on; return {}, as nothing is paused."""
        self._allow()
        return {}

    def _reset(self, spec: TrialSpec, limit_s: float) -> None:
        """Have services or the operator put the robot at the start, or raise."""
        start = spec.course.start
        if self.file.reset == OPERATOR:
            self._allow("start", "abort")
            self._loop.note(
                f"{spec.trial_id}: put the robot at the start of {spec.world.name}\n"
                f"  x {start.x:.3f} m, y {start.y:.3f} m, heading {start.yaw:.3f} rad"
                f" ({math.degrees(start.yaw):.0f} degrees)\n"
                f"  then {self._describe_calls()}"
            )
            self._loop.wait(lambda: self._calls, _OPERATOR_LIMIT_S)
            self.take_contact()
            return
        values = {
            "dataset": self._config.dataset,
            "world": spec.world_number,
            "robot": self._config.robot,
            "seed": spec.simulator_seed,
            "start_x_m": start.x,
            "start_y_m": start.y,
            "start_yaw_rad": start.yaw,
        }
        name, _, service = self.file.reset_service.rpartition("/")
        try:
            if self.file.world_node:
                node = RemoteNode(self._loop, self.file.world_node, SIMULATOR)
                node.set_parameters(values, limit_s)
            node = RemoteNode(self._loop, name, SIMULATOR)
            if self._interfaces is None:
                node.trigger(service, limit_s, limit_s)
            else:
                kind = self._interfaces.ResetSimulation
                request = kind.Request(scope=self.file.reset_scope)
                _call_simulator(node, service, kind, request, limit_s)
                if self.file.robot_entity:
                    kind = self._interfaces.SetEntityState
                    request = self._request_start(kind)
                    _call_simulator(node, "set_entity_state", kind, request, limit_s)
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.SIMULATOR_DIED, str(error)) from None
        except ServiceRefused as error:
            raise BarnError(f"{self.file.name}: {error}") from None

    def _request_start(self, kind: type[Any]) -> Any:
        """Return a request of SetEntityState for the robot at rest at the start."""
        request = kind.Request(entity=self.file.robot_entity)
        pose = request.state.pose
        place(pose, self._start.x, self._start.y, self._start.yaw)
        pose.position.z = self.file.robot_z_m
        # From version 2 on, a simulator sets only what it is asked to.
        for flag in ("set_pose", "set_twist"):
            if hasattr(request, flag):
                setattr(request, flag, True)
        return request

    def _read_pose(self, since_ns: int) -> Pose2D | None:
        """Take what has arrived; return the last pose sent since a time, or None."""
        messages: list[Message] = []
        self._subscriber.read(messages.append)
        pose = None
        for message in messages:
            is_pose = message.topic == self._topics.odometry
            if is_pose and message.sent_ns > since_ns:
                pose = decode.odometry(message.data).pose
        return pose

    def _allow(self, *names: str) -> None:
        """Forget calls; accept only these from now on, contact only if by operator."""
        self._calls.clear()
        is_reported = self.file.contact == OPERATOR
        self._allowed = tuple(
            name for name in names if name != "contact" or is_reported
        )

    def _describe_calls(self) -> str:
        """Return how to make the calls that count now, and what they do."""
        texts = []
        for name in self._allowed:
            call = f"{self._loop.node.get_fully_qualified_name()}/{name}"
            if self._has_keys:
                call = f"{name[0]} Enter"
            texts.append(f"{call} {_CALLS[name]}")
        return ", ".join(texts)

    def _take_call(self, name: str) -> str:
        """Note a call of the operator; return why it does not count, "" if it does."""
        if name in self._allowed:
            self._calls.add(name)
            return ""
        calls = self._describe_calls() or "no trial is under way"
        return f"that has no effect now: {calls}"

    def _read_keys(self) -> None:
        """Take a line from the terminal, if any, as a call; note if it is none."""
        terminal = sys.stdin.fileno()
        # In the background, reading would stop this process.
        is_mine = os.tcgetpgrp(terminal) == os.getpgrp()
        if is_mine and select.select([terminal], [], [], 0.0)[0]:
            key = sys.stdin.readline().strip().lower()
            name = next((name for name in _CALLS if key in (name, name[0])), "")
            problem = self._take_call(name)
            if problem:
                self._loop.note(problem)

    def _answer(self, name: str):  # type: ignore[no-untyped-def]
        """Return the callback of a service that takes the operator's call."""

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            """Take the operator's call; answer whether it counts."""
            response.message = self._take_call(name)
            response.success = not response.message
            return response

        return answer


def load_interfaces() -> ModuleType:
    """Return the services of simulation_interfaces; ConfigError if not installed."""
    try:
        return import_module(f"{INTERFACES}.srv")
    except ImportError:
        raise ConfigError(
            f"reset {INTERFACES}: the package is not installed; make install builds it"
            " if there is a C++ compiler; or set reset to service or operator"
        ) from None


def _call_simulator(
    node: RemoteNode, service: str, kind: type[Any], request: Any, limit_s: float
) -> None:
    """Call a service once; ServiceRefused unless its result is RESULT_OK."""
    result = node.call(service, kind, request, limit_s, limit_s).result
    if result.result != _RESULT_OK:
        reason = result.error_message or f"result {result.result}"
        raise ServiceRefused(f"{node.name}/{service}: {reason}")


class ObservedQueue(TrialQueue):
    """Sorts messages by the poses of a system, in the order of their arrival."""

    def __init__(
        self,
        system: ObservedSystem,
        subscriber: Subscriber,
        topics: TrialTopics,
        reset_ns: int,
    ):
        """Prepare for the first pose after a reset.

        Args:
            system: The system.
            subscriber: Brings the messages.
            topics: Names of the topics that the trial is judged by.
            reset_ns: Wall-clock time before which messages are not of the trial.
        """
        # A pose completes the tick before, whether or not there are scans.
        judged = topics._replace(scan=topics.odometry, clock=topics.odometry)
        super().__init__(subscriber, judged, reset_ns, None)
        # The longest time without a reading so far.
        self.longest_gap_ns = 0
        self._system = system
        # Stamps so far, and since then those that do not fit, if any.
        self._stamps: StampSeries | None = None
        self._wrong: StampSeries | None = None

    def read(self) -> None:
        """Take the messages that have arrived, in the order of arrival."""
        messages: list[Message] = []
        self._subscriber.read(messages.append)
        messages.sort(key=lambda message: message.sent_ns)
        for message in messages:
            self._take(message)

    def _take(self, message: Message) -> None:
        """Take a message, unless it is a pose of the trial whose stamp is wrong."""
        is_pose = message.topic == self._topics.clock
        if message.sent_ns < self._reset_ns or not is_pose or self._accepts(message):
            super()._take(message)

    def _accepts(self, pose: Message) -> bool:
        """Return whether a pose's stamp fits; TrialEnded if the clock was set."""
        stamp_ns = self._read_time(pose)
        if self._stamps is None:
            self._stamps = StampSeries(stamp_ns, pose.sent_ns)
            return True
        step_ns = stamp_ns - self.now_ns
        arrival_step_ns = pose.sent_ns - self._stamps.last_arrival_ns
        if self._stamps.extend(stamp_ns, pose.sent_ns):
            gap_ns = step_ns
            # A wrong stamp before may have hidden that the clock was set a little.
            if self._wrong is not None:
                gap_ns = max(step_ns, arrival_step_ns)
            self.longest_gap_ns = max(self.longest_gap_ns, gap_ns)
            self._wrong = None
            return True
        if self._wrong is None or not self._wrong.extend(stamp_ns, pose.sent_ns):
            self._wrong = StampSeries(stamp_ns, pose.sent_ns)
        if self._wrong.shows_clock:
            # What has arrived by now is read once more, to be recorded.
            self._wrong = None
            raise TrialEnded(
                Outcome.ENVIRONMENT_FAILED,
                f"stamps of {pose.topic} jump by {seconds(step_ns):+.2f} s: the clock"
                " was set, so times are unknown",
            )
        return False

    def _read_time(self, message: Message) -> int:
        """Return a pose's time, by its stamp or its arrival."""
        if self._system.file.clock == "stamps":
            return decode.odometry(message.data).stamp_ns
        return message.sent_ns
