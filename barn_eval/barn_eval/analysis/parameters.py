"""In which parameters two planners differ, as far as anything is known of them."""

from typing import Any

from barn_eval.analysis.sources import Source
from barn_eval.analysis.text_table import joined
from barn_eval.experiments.command_files import told_parameters
from barn_eval.experiments.store import LOGS
from barn_eval.trials.identity import MISSING, leaves
from barn_planners.registry import planner_config
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError

_NAMED = 5


def changed_parameters(a: Source, of_a: str, b: Source, of_b: str) -> str:
    """Return in a sentence what differs between two planners' parameters and files (SHA-256); empty if nothing does.

    Those of the registry by their presets and overrides, others as their nodes told them; of planners or nodes that are
    not of the same name, nothing is said, and of files of other names only where nothing else differs.
    """
    one, other = _parameters(a, of_a), _parameters(b, of_b)
    shared = {key.partition(" ")[0] for key in one} & {key.partition(" ")[0] for key in other}
    keys = [key for key in one | other if key.partition(" ")[0] in shared and one.get(key) != other.get(key)]
    keys = [key for key in keys if not key.startswith("file ") or key in one.keys() & other.keys()] or keys
    named = [f"{key} ({one.get(key, MISSING)} against {other.get(key, MISSING)})" for key in keys[:_NAMED]]
    more = [f"{len(keys) - _NAMED} more"] if len(keys) > _NAMED else []
    return f"Parameters that differ: {joined([*named, *more])}." if named else ""


def _parameters(source: Source, planner: str) -> dict[str, Any]:
    try:
        (choice,) = (one for one in source.experiment.planners if one.name == planner)
        if not choice.registered:
            files = {f"file {name}": digest[:12] for name, digest in choice.files.items()}
            return files | told_parameters(source.path / LOGS, planner)
        settings = source.experiment.settings(choice)
        config = planner_config(planner, settings["preset"], settings["overrides"])
        return {f"{planner} {key}": value for key, value in leaves(as_dict(config))}
    except (BarnError, ValueError):
        return {}  # of another version of the suite, or of a planner that is not installed here
