"""The configuration of the learning environment."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from barn_planners.policy.collision_check import CollisionCheckConfig
from barn_planners.policy.space import PolicyAction, PolicyObservation
from barn_worlds.base.config import Checked, quantity, replace_dotted
from barn_worlds.base.errors import ConfigError, suggest

STRAIGHT = "straight"
ALONG_PATH = "path"


@dataclass(frozen=True)
class RewardConfig(Checked):
    """What a step is worth; the terms are added up."""

    discount: float = quantity(
        0.995,
        "discount per step of the learner, which shapes the reward for progress",
        "",
        0.0,
        1.0,
    )
    progress_per_m: float = quantity(
        1.0,
        "reward for each meter of progress from the start; moving back costs the same amount",
    )
    progress_along: str = quantity(
        ALONG_PATH,
        "whether progress is measured along a straight line or along the world's path",
        choices=(STRAIGHT, ALONG_PATH),
    )
    per_second: float = quantity(-0.1, "reward for each second of an episode")
    near_per_second: float = quantity(
        -0.5,
        "reward for each second at an obstacle; the reward falls linearly with the distance",
    )
    near_m: float = quantity(
        0.6,
        "lidar range beyond which near_per_second does not apply",
        "m",
        minimum=0.01,
    )
    shielded_per_second: float = quantity(
        -1.0, "reward for each second in which the collision check changes the command"
    )
    shielded_limit: float = quantity(
        5.0, "limit of the sum of shielded_per_second in an episode", minimum=0.0
    )
    success: float = quantity(10.0, "reward for reaching the goal")
    collision: float = quantity(
        -10.0,
        "reward for a contact that ends the trial, for leaving the world beyond its edge,"
        " or for a command that is not finite",
    )
    out_of_time: float = quantity(
        -10.0, "reward for exceeding the protocol's time limit"
    )


@dataclass(frozen=True)
class EnvConfig(Checked):
    """The environment: its worlds, rules, robot, observations, actions and rewards."""

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity(
        "all", "worlds of the data set, such as 0, 0-49 or 0:300:6", is_selection=True
    )
    protocol: str = quantity("challenge", "protocol: a name or a YAML file")
    robot: str = quantity("jackal", "robot: a name or a YAML file")
    # Parameters of the simulator by dotted name, over those of the protocol.
    simulator: dict[str, Any] = field(default_factory=dict)
    observation: PolicyObservation = field(default_factory=PolicyObservation)
    action: PolicyAction = field(default_factory=PolicyAction)
    # The check that the policy planner has too. It is off by default, so that a policy
    # learns from its collisions.
    safety: CollisionCheckConfig = field(
        default_factory=lambda: CollisionCheckConfig(enabled=False)
    )
    reward: RewardConfig = RewardConfig()


class UnknownArgumentError(ConfigError, TypeError):
    """An argument that the environment does not have.

    It is also a TypeError, by which wrappers find out what an environment takes.
    """


def configure(config: EnvConfig | None, changes: Mapping[str, object]) -> EnvConfig:
    """Return a configuration changed by keywords; ConfigError if one is unknown.

    Args:
        config: Configuration to start from; by default `EnvConfig()`.
        changes: New values by dotted field name. `worlds` may also be a number or
            several, and a nested configuration may be an object of its class.

    Raises:
        UnknownArgumentError: If a name is not that of a field.
        ConfigError: If a value is not allowed.
    """
    config = config or EnvConfig()
    names = [item.name for item in fields(EnvConfig)]
    plain: dict[str, object] = {}
    for name, value in changes.items():
        if name.partition(".")[0] not in names:
            raise UnknownArgumentError(
                f"environment: got an unexpected keyword argument {name!r}"
                f"{suggest(name, names)}"
            )
        current = getattr(config, name, None)
        if isinstance(value, Checked) and type(value) is type(current):
            part: dict[str, Any] = {name: value}
            config = replace(config, **part)
        else:
            plain[name] = value
    return replace_dotted(config, plain, "environment")
