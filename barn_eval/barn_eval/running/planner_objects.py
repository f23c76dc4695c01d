"""Planners given as Python objects: a Planner class, an object of one, or a plain function."""

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cloudpickle

from barn_eval.trials.run_config import UNKNOWN_SOURCE, PlannerChoice
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_planners.registry import planner_names
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import Velocity2D

Answer = tuple[float, float] | Velocity2D | None
Function = Callable[[Observation], Answer] | Callable[[Observation, Task], Answer]
Live = Planner | type[Planner] | Function
OnePlanner = str | PlannerChoice | Live
Planners = (
    OnePlanner
    | Mapping[str, OnePlanner]
    | Sequence[OnePlanner | Mapping[str, OnePlanner]]
)


@dataclass(frozen=True)
class LivePlanner:
    """A planner given as a Python object, by the name that its results are filed under."""

    name: str
    given: Any

    def make(self) -> Planner:
        """Return the planner for a trial: a new one of a class, else the object; BarnError if it cannot be made."""
        try:
            made = self.given() if isinstance(self.given, type) else self.given
        except Exception as error:
            raise BarnError(
                f"planner {self.name!r} cannot be made: {type(error).__name__}: {error}"
            ) from error
        return made if isinstance(made, Planner) else FunctionPlanner(made)


class FunctionPlanner(Planner):
    """Drives by a function of the observation, or of observation and task, that returns (m/s forward, rad/s turn)."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._takes_task = _accepts(function, 2)
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002 (a function has no randomness of its own)
        """Begin a trial."""
        self._task = task

    def step(self, observation: Observation) -> Decision:
        """Ask the function; None sends nothing in this cycle. TypeError for any other answer than two numbers."""
        answer = (
            self._function(observation, self._task)
            if self._takes_task
            else self._function(observation)
        )
        if answer is None or isinstance(answer, Velocity2D):
            return Decision(answer)
        try:
            forward, turn = map(float, answer)
        except (TypeError, ValueError):
            raise TypeError(
                f"a planner's function must return (m/s, rad/s), got {answer!r}"
            ) from None
        return Decision(Velocity2D(forward, turn))


def split_planners(given: Planners) -> tuple[list[Any], dict[str, LivePlanner]]:
    """Return planners as a request takes them, and those among them that are Python objects, by name."""
    if isinstance(given, str):
        return given.split(","), {}
    entries: list[Any] = list(given) if isinstance(given, (list, tuple)) else [given]
    chosen: list[Any] = []
    live: dict[str, LivePlanner] = {}
    for entry in entries:
        named = isinstance(entry, Mapping) and not all(
            isinstance(value, (str, Mapping)) for value in entry.values()
        )
        for name, item in entry.items() if named else [(None, entry)]:
            if isinstance(item, (str, Mapping, PlannerChoice)):
                chosen.append(item)
                continue
            _check(item)
            planner = LivePlanner(name or _name(item), item)
            if planner.name in planner_names():
                raise ConfigError(
                    f"planner {planner.name!r}: is one of the registry's; give yours another name"
                )
            live[planner.name] = planner
            chosen.append(PlannerChoice(planner.name, source=fingerprint(item)))
    return chosen, live


def fingerprint(planner: object) -> str:
    """Return SHA-256 of the source of a planner's class or function and of what it holds; NO_SOURCE if not known."""
    code = (
        planner
        if isinstance(planner, type) or inspect.isroutine(planner)
        else type(planner)
    )
    held: Any = (
        None
        if code is planner
        else vars(planner)
        if hasattr(planner, "__dict__")
        else repr(planner)
    )
    if inspect.isfunction(planner):
        held = (
            [cell.cell_contents for cell in planner.__closure__ or ()],
            planner.__defaults__,
            planner.__kwdefaults__,
        )
    try:
        return hashlib.sha256(
            inspect.getsource(code).encode() + cloudpickle.dumps(held)
        ).hexdigest()
    except Exception:  # whatever an object does when it is pickled
        return UNKNOWN_SOURCE


def _check(planner: Any) -> None:
    if isinstance(planner, type) and not issubclass(planner, Planner):
        raise ConfigError(
            f"planner {planner.__name__}: must be derived from barn_planners.interface.Planner"
        )
    if not (
        isinstance(planner, (type, Planner))
        or _accepts(planner, 1)
        or _accepts(planner, 2)
    ):
        kinds = "a name, a Planner class or object, or a function of the observation"
        raise ConfigError(f"a planner must be {kinds}, got {planner!r}")


def _name(planner: object) -> str:
    name = (
        type(planner).__name__
        if isinstance(planner, Planner)
        else str(getattr(planner, "__name__", ""))
    )
    if not name.isidentifier():
        raise ConfigError(
            f"planner {planner!r}: has no name; give it one, as {{'name': planner}}"
        )
    return name


def _accepts(function: Callable[..., Any], count: int) -> bool:
    """Tell whether a function can be called with so many arguments and no more information."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except (TypeError, ValueError):
        return False
    return True
