"""Settings of one planner side by side: each is an experiment of its own, in a folder that its values name."""

import hashlib
import itertools
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from barn_eval.results.run_file import RUN_FILE
from barn_eval.running.request import (
    SCHEMA_VERSION,
    Given,
    Request,
    Values,
    command_words,
    read_request,
)
from barn_eval.trials.run_config import PlannerChoice
from barn_worlds.base.errors import ConfigError, format_value, suggest
from barn_worlds.base.files import read_bytes, write_bytes
from barn_worlds.base.text_files import parse_yaml, read_yaml

MOST_SETTINGS = 400
LATENCY = "latency"
PARAMETERS = (
    "parameters"  # the folder of parameter files that were written for settings
)
_VALUE = re.compile(r"([^=,]+)=([^=,]+)")
Sweep = Mapping[str, Sequence[Any]]
Ask = Callable[..., Request]


@dataclass(frozen=True)
class Setting:
    """A point of the grid: its name, the values by the short names of parameters, and what is run for it.

    files: what parameter files of a planner that a command starts are to hold.
    """

    name: str
    values: Values
    request: Request
    files: Mapping[Path, bytes]

    def write_files(self) -> None:
        """Write its parameter files."""
        for path, content in self.files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, content)


def parse_sweep(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Return the values of each parameter from texts "KEY=V1,V2,..."; ConfigError for anything else."""
    found: dict[str, list[Any]] = {}
    for text in texts:
        key, _, values = text.partition("=")
        listed = parse_yaml(f"[{values}]", f"--sweep {format_value(text)}")
        if (
            not key.strip()
            or not listed
            or not isinstance(listed, list)
            or key in found
        ):
            raise ConfigError(
                f"--sweep {format_value(text)}: must be KEY=V1,V2,..., each key given once"
            )
        found[key.strip()] = listed
    return found


def sweep_of(path: Path | None, texts: Sequence[str]) -> Mapping[str, Sequence[Any]]:
    """Return the sweep that is asked for by texts, or else by a file; empty if there is none."""
    asked = read_yaml(path, SCHEMA_VERSION).get("sweep") if path and not texts else None
    if asked is not None and not isinstance(asked, Mapping):
        raise ConfigError(
            f"{path}: sweep must be a mapping of parameters to lists of values, got {format_value(asked)}"
        )
    return asked or parse_sweep(texts)


def grid(
    sweep: Sweep,
    path: Path | None,
    options: Values,
    settings: Values | None = None,
    worlds: Given = None,
) -> list[Setting]:
    """Return every combination of the values, as requests for folders below the one that is asked for.

    A key is a parameter of the only planner: of one of the suite's, by its dotted name; of one that a command starts, a
    ROS parameter, which is set by `-p`, or, where the command has a `--params-file`, a dotted key of that file, of
    which each setting gets a copy. The key "latency" alone is the delay in s of all planners. The other arguments are
    those of `read_request`.
    """
    ask: Ask = partial(read_request, path, worlds=worlds)
    base = ask(options, settings)
    if list(sweep) == [LATENCY]:
        asked_s = {
            one: {**options, "out": base.out / f"{LATENCY}={value_text(one)}"}
            for one in _delays(sweep)
        }
        return [
            _late(delay_s, read_request(path, asked, settings, worlds))
            for delay_s, asked in asked_s.items()
        ]
    planners = base.experiment.planners
    if len(planners) != 1:
        raise ConfigError(
            f"a sweep is of one planner, got {', '.join(one.name for one in planners)}"
        )
    _require_values(sweep)
    names = _short(list(sweep))
    found = []
    for values in itertools.product(*sweep.values()):
        named = dict(zip(names, values, strict=True))
        name = ",".join(f"{key}={value_text(value)}" for key, value in named.items())
        folder = re.sub(r"[^A-Za-z0-9_.=,+-]", "_", name)
        changes = dict(zip(sweep, values, strict=True))
        found.append(
            replace(
                setting(base, ask, options, settings or {}, changes, folder),
                name=name,
                values=named,
            )
        )
    if len({one.request.out for one in found}) < len(found):
        raise ConfigError("a sweep names one value twice")
    return found


def setting(
    base: Request,
    ask: Ask,
    options: Values,
    settings: Values,
    changes: Values,
    folder: str,
) -> Setting:
    """Return `ask(options, settings)` with other values of parameters of the planner, in a folder below that of `base`.

    base: the same without. ConfigError for what the planner does not take.
    """
    files: dict[Path, bytes] = {}
    asked, own = {**options, "out": base.out / folder}, dict(settings)
    if (planner := base.experiment.planners[0]).command:
        asked["planner_command"], files = _with_parameters(
            planner, changes, base.out / PARAMETERS / f"{folder}.yaml"
        )
    else:
        own |= changes
    request = ask(asked, own)
    # known by what they will hold: when a run is resumed, they are there already
    digests = {
        str(path): hashlib.sha256(content).hexdigest()
        for path, content in files.items()
    }
    planners = tuple(
        replace(one, files=one.files | digests) for one in request.experiment.planners
    )
    request.experiment.resolve_planner(
        planners[0]
    )  # refuses what the planner does not take
    request = replace(
        request, experiment=replace(request.experiment, planners=planners)
    )
    return Setting(folder, changes, request, files)


def _delays(sweep: Sweep) -> list[float]:
    _require_values(sweep)
    values = sweep[LATENCY]
    if any(isinstance(value, str | bool) for value in values) or len(set(values)) < len(
        values
    ):
        raise ConfigError(
            f"latency: must be delays in s, each named once, got {format_value(list(values))}"
        )
    return list(map(float, values))


def _late(delay_s: float, request: Request) -> Setting:
    """Return the setting in which the commands of all planners come late; at 0 they compute as they declare."""
    experiment = request.experiment
    if delay_s:
        late = [
            replace(
                one, delay_s=delay_s, delay_p95_s=0.0, period_s=one.compute.period_s
            )
            for one in experiment.planners
        ]
        experiment = replace(experiment, planners=tuple(late))
    return Setting(
        request.out.name,
        {LATENCY: delay_s},
        replace(request, experiment=experiment),
        {},
    )


def swept_folders(path: Path) -> list[Path]:
    """Return the folders of the settings below a folder of a sweep, by their values; none if it is no such folder."""
    if (path / RUN_FILE).exists() or not path.is_dir():
        return []
    found = [
        one for one in path.iterdir() if values_of(one) and (one / RUN_FILE).exists()
    ]
    return sorted(
        found,
        key=lambda one: [
            (str(type(value)), value) for value in values_of(one).values()
        ],
    )


def expanded(paths: Sequence[Path]) -> list[Path]:
    """Return folders of experiments, with those of settings in place of the folder of a sweep."""
    return [one for path in paths for one in (swept_folders(path) or [path])]


def values_of(path: Path) -> dict[str, Any]:
    """Return the values that the folder of a setting is named by; empty if it is no such folder."""
    parts = [_VALUE.fullmatch(part) for part in path.name.split(",")]
    return {part[1]: _number(part[2]) for part in parts if part} if all(parts) else {}


def _require_values(sweep: Sweep) -> None:
    for key, values in sweep.items():
        if not isinstance(values, Sequence) or isinstance(values, str) or not values:
            raise ConfigError(
                f"sweep of {format_value(key)}: must be a list of values, got {format_value(values)}"
            )
        for value in (
            one for one in values if not isinstance(one, str | bool | int | float)
        ):
            raise ConfigError(
                f"sweep of {format_value(key)}: a value must be a number, a text, true or false, got {value!r}"
            )
    if (count := math.prod(len(values) for values in sweep.values())) > MOST_SETTINGS:
        raise ConfigError(
            f"a sweep may have {MOST_SETTINGS} settings, these are {count}"
        )


def _short(keys: Sequence[str]) -> list[str]:
    """Return the last part of dotted names, whole names where that is not enough to tell them apart."""
    last = [key.rpartition(".")[2] for key in keys]
    return (
        last if len(set(last)) == len(last) else [key.replace("=", "_") for key in keys]
    )


def value_text(one: object) -> str:
    """Return a value as folders, tables and figures name it."""
    return (
        f"{one:.10g}"
        if isinstance(one, float)
        else str(one).lower()
        if isinstance(one, bool)
        else str(one)
    )


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _with_parameters(
    planner: PlannerChoice, changes: Values, file: Path
) -> tuple[str, dict[Path, bytes]]:
    """Return the command that starts a planner with changed parameters, and the parameter files that it then needs."""
    words, files = command_words(planner.command), {}
    contents = _contents(words)
    for key, value in changes.items():
        if contents:
            place, mapping, last = _place(contents, key)
            mapping[last] = value
            own = (
                file.with_stem(f"{file.stem}_{Path(contents[place][0]).stem}")
                if len(contents) > 1
                else file
            )
            files[own.absolute()] = place
        else:
            words += [] if "--ros-args" in words else ["--ros-args"]
            words += ["-p", f"{key}:={value_text(value)}"]
    for path, place in files.items():
        words[place] = str(path)
    made = {
        path: yaml.safe_dump(contents[place][1], sort_keys=False).encode()
        for path, place in files.items()
    }
    return f"{planner.name}={shlex.join(words)}", made


def values_in_files(command: str, keys: Sequence[str]) -> dict[str, Any]:
    """Return the values of parameters in the parameter files of a command, none where it has no such file."""
    contents = _contents(command_words(command))
    places = {key: _place(contents, key)[1:] for key in keys} if contents else {}
    return {key: mapping[last] for key, (mapping, last) in places.items()}


def _contents(words: Sequence[str]) -> dict[int, tuple[str, dict[str, Any]]]:
    """Return parameter files by their places among the words of a command, each with its content."""
    found = {}
    for place in [
        number + 1 for number, word in enumerate(words[:-1]) if word == "--params-file"
    ]:
        content = parse_yaml(read_bytes(Path(words[place])), words[place])
        if not isinstance(content, dict):
            raise ConfigError(
                f"{words[place]}: must be a mapping of nodes to ros__parameters"
            )
        found[place] = (words[place], content)
    return found


def _place(
    contents: Mapping[int, tuple[str, dict[str, Any]]], key: str
) -> tuple[int, dict[str, Any], str]:
    """Return where the only parameter of that name, "NODE.key" or "key", is: in the last file that has it."""
    names: set[str] = set()
    for place, (source, content) in reversed(list(contents.items())):
        places = {
            (node, name): (mapping, last)
            for node, parameters in _nodes(content)
            for name, mapping, last in _leaves(parameters)
        }
        found = [
            one
            for (node, name), one in places.items()
            if key in (name, f"{node}.{name}")
        ]
        if len(found) > 1:
            raise ConfigError(
                f"{source}: has several parameters {key!r}; name the node"
            )
        if found:
            return place, *found[0]
        names |= {name for _, name in places} | {
            f"{node}.{name}" for node, name in places
        }
    sources = ", ".join(source for source, _ in contents.values())
    raise ConfigError(
        f"{sources}: has no parameter {key!r}{suggest(key, sorted(names))}"
    )


def _nodes(content: Values, before: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the nodes of a parameter file by dotted name, each with its parameters."""
    for node, about in content.items():
        parameters = about.get("ros__parameters") if isinstance(about, dict) else None
        if isinstance(parameters, dict):
            yield f"{before}{node}", parameters
        elif isinstance(about, dict):
            yield from _nodes(about, f"{before}{node}.")


def _leaves(
    mapping: dict[str, Any], before: str = ""
) -> list[tuple[str, dict[str, Any], str]]:
    found = []
    for key, value in mapping.items():
        name = f"{before}{key}"
        found += (
            _leaves(value, f"{name}.")
            if isinstance(value, dict)
            else [(name, mapping, key)]
        )
    return found
