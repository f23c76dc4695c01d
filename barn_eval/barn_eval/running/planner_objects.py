"""Planners that are Python objects: a Planner class, its instance, or a function."""

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import cloudpickle

from barn_eval.running.planner_choices import read_planner, rename_planner
from barn_eval.trials.run_config import UNKNOWN_SOURCE, PlannerChoice
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_planners.registry import planner_names
from barn_worlds.base.errors import BarnError, ConfigError, format_value
from barn_worlds.base.types import Velocity2D

Answer = tuple[float, float] | Velocity2D | None
Function = Callable[[Observation], Answer] | Callable[[Observation, Task], Answer]
PlannerSource: TypeAlias = Planner | type[Planner] | Function
OnePlanner: TypeAlias = str | PlannerChoice | PlannerSource
Planners: TypeAlias = (
    OnePlanner
    | Mapping[str, OnePlanner]
    | Sequence[OnePlanner | Mapping[str, OnePlanner]]
)


@dataclass(frozen=True)
class PlannerObject:
    """A planner handed over as a Python object."""

    # Name of the planner in the results.
    name: str

    # The class, object or function.
    source: PlannerSource

    def make_planner(self) -> Planner:
        """Return a new instance of a class, the object or a wrapped function; or raise.

        Raises:
            BarnError: If the class cannot be instantiated.
        """
        source = self.source
        if isinstance(source, type):
            try:
                planner: Planner = source()
                return planner
            except Exception as error:
                raise BarnError(
                    f"planner {self.name!r} cannot be created: {type(error).__name__}: {error}"
                ) from error
        return source if isinstance(source, Planner) else FunctionPlanner(source)


class FunctionPlanner(Planner):
    """A planner that asks a function of the observation, or of observation and task."""

    def __init__(self, function: Callable[..., Any]):
        """Keep a function of the observation, or of observation and task."""
        self._function = function
        self._takes_task = _accepts(function, 2)
        self._task: Task | None = None

    def start(self, task: Task, seed: int) -> None:  # noqa: ARG002 (no randomness)
        """Keep goal and map of a new trial, for functions of two arguments.

        Args:
            task: Goal and map, for functions that take two arguments.
            seed: Not used.
        """
        self._task = task

    def step(self, observation: Observation) -> Decision:
        """Return what the function commands, if anything; TypeError for other answers.

        Raises:
            TypeError: If the function returns anything but None, a command or two
                numbers for forward speed [m/s] and yaw rate [rad/s].
        """
        arguments = (observation, self._task) if self._takes_task else (observation,)
        answer = self._function(*arguments)
        if answer is None or isinstance(answer, Velocity2D):
            return Decision(answer)
        try:
            # Numbers of numpy and torch count as numbers.
            forward, turn = map(float, answer)
        except (TypeError, ValueError):
            raise TypeError(
                f"a planner's function must return (m/s, rad/s), got {answer!r}"
            ) from None
        return Decision(Velocity2D(forward, turn))


def split_planner_objects(
    planners: Planners,
) -> tuple[list[Any], dict[str, PlannerObject]]:
    """Return (entries for `read_planners`, objects by name); ConfigError if no planner.

    Args:
        planners: What `barn.run` takes as `planners`.

    Returns:
        Entries for `read_planners`, in which a `PlannerChoice` with a source hash
        stands for each object; and the objects by planner name.

    Raises:
        ConfigError: If an object is no planner, has no name or one of the registry's.
    """
    if isinstance(planners, str):
        return planners.split(","), {}
    entries = list(planners) if isinstance(planners, (list, tuple)) else [planners]
    choices: list[Any] = []
    objects: dict[str, PlannerObject] = {}
    for name, source in _name_entries(entries):
        if isinstance(source, (str, Mapping, PlannerChoice)):
            choice = source
            if name:
                choice = rename_planner(read_planner(source, ""), name)
            choices.append(choice)
            continue
        _require_planner(source)
        planner = PlannerObject(name or _default_name(source), source)
        # Results of two planners under one name would be compared as one.
        if planner.name in planner_names():
            raise ConfigError(
                f"planner {planner.name!r}: is a registered planner; give your planner"
                " a different name"
            )
        objects[planner.name] = planner
        choices.append(PlannerChoice(planner.name, source=fingerprint(source)))
    return choices, objects


def _name_entries(entries: Sequence[Any]) -> list[tuple[str, Any]]:
    """Return (name, planner) pairs of entries and mappings; the name may be empty."""
    pairs: list[tuple[str, Any]] = []
    for entry in entries:
        # A mapping of texts and mappings alone has the fields of one PlannerChoice.
        is_fields = isinstance(entry, Mapping) and all(
            isinstance(value, (str, Mapping)) for value in entry.values()
        )
        if isinstance(entry, Mapping) and not is_fields:
            pairs += entry.items()
        else:
            pairs.append(("", entry))
    return pairs


def fingerprint(planner: object) -> str:
    """Return SHA-256 of a planner's own source and values, or `UNKNOWN_SOURCE`.

    Values are an object's attributes, or what a function closes over and its defaults.
    Source of what the planner calls is not in it.

    Args:
        planner: A Planner class, object or function.

    Returns:
        The hash in hexadecimal digits; `UNKNOWN_SOURCE` if the source cannot be read or
        the values cannot be serialized.
    """
    code: Any = planner
    state: Any = None
    # Functions made by one source differ in what they close over.
    if inspect.isfunction(planner):
        cells = [cell.cell_contents for cell in planner.__closure__ or ()]
        state = (cells, planner.__defaults__, planner.__kwdefaults__)
    elif not (isinstance(planner, type) or inspect.isroutine(planner)):
        code = type(planner)
        state = vars(planner) if hasattr(planner, "__dict__") else repr(planner)
    try:
        source = inspect.getsource(code).encode()
        return hashlib.sha256(source + cloudpickle.dumps(state)).hexdigest()
    # The object's own code runs while it is pickled, and may raise anything.
    except Exception:
        return UNKNOWN_SOURCE


def _require_planner(planner: Any) -> None:
    """Raise ConfigError unless `planner` is a Planner or a function of 1 or 2 values."""
    if isinstance(planner, type):
        if not issubclass(planner, Planner):
            raise ConfigError(
                f"planner {planner.__name__}: must be derived from"
                " barn_planners.interface.Planner"
            )
    elif not (
        isinstance(planner, Planner) or _accepts(planner, 1) or _accepts(planner, 2)
    ):
        raise ConfigError(
            "a planner must be a name, a Planner class or object, or a function of the"
            f" observation, got {format_value(planner)}"
        )


def _default_name(planner: object) -> str:
    """Return the name of a function or class; ConfigError for a lambda."""
    named = type(planner) if isinstance(planner, Planner) else planner
    name = str(getattr(named, "__name__", ""))
    if not name.isidentifier():
        raise ConfigError(
            f"planner {format_value(planner)}: no name; give it one, as"
            " {'name': planner}"
        )
    return name


def _accepts(function: Callable[..., Any], count: int) -> bool:
    """Return whether a function takes `count` positional arguments, without a call."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except (TypeError, ValueError):
        return False
    return True
