"""The simulator node as the evaluator uses it."""

import re
import time
from pathlib import Path
from typing import Any

from barn_eval.experiments.ros_config import Patience
from barn_eval.ros.remote import SET_PARAMETERS, RemoteNode, ServiceRefused, ServiceTimeout
from barn_eval.ros.session import PLANNER, SIMULATOR, Session, TrialEnded
from barn_eval.ros.simulator_channel import SimulatorChannel
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.config import fields_of
from barn_worlds.base.errors import BarnError

_SERVICES = (SET_PARAMETERS, "reset", "pause")
_CONNECTED = re.compile(r"(\d+) scan subscriptions, (\d+) command publishers")
_LOOK_S = 0.02
_MISSED = re.compile(r"(\d+) missed commands")


class SimulatorClient:
    """Sets up, resets, pauses and releases the simulator; every failure to do so ends the trial, or the run."""

    def __init__(self, session: Session, node: RemoteNode | SimulatorChannel, patience: Patience, robot: str) -> None:
        """Robot: name, or path of the file, of the one that all trials are of."""
        self._session = session
        self._node = node
        self._patience = patience
        self._robot = robot

    def prepare(self, spec: TrialSpec, dataset: str, start_limit_s: float) -> int:
        """Put the robot of a trial in its place, paused, and return the wall-clock time before that was asked for.

        start_limit_s: how long the simulator may take to appear.
        Raises TrialEnded if the simulator does not answer and BarnError if it cannot do what the trial needs.
        """
        limit_s = self._patience.simulator_s
        try:
            self._node.await_services(_SERVICES, start_limit_s)
            self._node.switch("pause", True, limit_s)
            self._node.set_parameters(parameters(spec, dataset, self._robot), limit_s)
            asked_ns = time.time_ns()
            self._node.trigger_once("reset", limit_s)
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.SIMULATOR_DIED, str(error)) from None
        except ServiceRefused as error:
            raise BarnError(f"simulator: {error}") from None
        return asked_ns

    def await_connections(self, scan_subscriptions: int, command_publishers: int) -> bool:
        """Wait until the simulator is connected with as many others; False if it is not within the limit.

        What is on the graph need not be connected yet, and the first scan of a trial must not be lost.
        """
        deadline = time.monotonic() + self._patience.connection_s
        while True:
            connected = _CONNECTED.search(self._pause(True))
            if connected is None:  # a simulator that does not say
                return True
            if int(connected[1]) >= scan_subscriptions and int(connected[2]) >= command_publishers:
                return True
            if time.monotonic() > deadline:
                return False
            self._session.sleep(_LOOK_S, PLANNER, SIMULATOR)

    def release(self) -> None:
        """Let the simulated time run."""
        self._pause(False)

    def pause(self) -> int:
        """Stop the simulated time and return in how many cycles the simulator has waited in vain for a command."""
        missed = _MISSED.search(self._pause(True))
        return int(missed[1]) if missed else 0

    def _pause(self, on: bool) -> str:
        try:
            return self._node.switch("pause", on, self._patience.service_s)
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.SIMULATOR_DIED, str(error)) from None
        except ServiceRefused as error:
            raise BarnError(f"simulator: {error}") from None


def parameters(spec: TrialSpec, dataset: str, robot: str) -> dict[str, Any]:
    """Return the simulator's parameters for a trial in a world of a data set; both and the robot by name or path."""
    start = spec.course.start
    configuration = {name: value for name, _, value in fields_of(spec.simulator)}
    return configuration | {
        "robot": robot,
        "dataset": str(Path(dataset).resolve()) if Path(dataset).exists() else dataset,
        "world": spec.index,
        "start_x_m": start.x,
        "start_y_m": start.y,
        "start_yaw_rad": start.yaw,
        "seed": spec.simulator_seed,
    }
