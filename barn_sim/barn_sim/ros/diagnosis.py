"""The simulator node's status on /diagnostics."""

import math

from barn_sim.ros.commands import CommandInput
from barn_sim.ros.trial import Trial
from barn_worlds.messages.encode import ERROR, FINE, WARNING, encode_diagnostics
from barn_worlds.messages.topics import SIMULATOR_DIAGNOSTICS, Outgoing
from barn_worlds.types import seconds

_FAULTS = ("missed_commands", "invalid_commands")


def diagnosis(trial: Trial, commands: CommandInput, state: str, real_time_factor: float | None) -> Outgoing:
    """Return the report: an error if commands are not heard, a warning if some were missed or were not numbers.

    real_time_factor: achieved; None in lockstep, NaN while it is not known.
    """
    counts = trial.counts()
    faults = [f"{counts[key]} {key.replace('_', ' ')}" for key in _FAULTS if counts[key]]
    level = WARNING if faults else FINE
    if commands.complaint:
        level = ERROR
        faults.insert(0, commands.complaint)
    values: dict[str, object] = {
        "state": state,
        "world": trial.world_name,
        "seed": trial.config.seed,
        "simulated_s": f"{seconds(trial.simulator.stamp_ns):.3f}",
        "command_type": commands.kind,
        **counts,
    }
    if real_time_factor is not None and not math.isnan(real_time_factor):
        values["real_time_factor"] = f"{real_time_factor:.3f}"
    texts = {key: str(value) for key, value in values.items()}
    message = "; ".join(faults) or state
    data = encode_diagnostics(trial.now_ns, level, "simulator", message, texts, hardware_id="simulated jackal")
    return Outgoing(SIMULATOR_DIAGNOSTICS, data)
