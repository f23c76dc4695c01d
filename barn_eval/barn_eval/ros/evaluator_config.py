"""Configuration of the evaluator node: the run, whom it talks to, and how long it waits."""

from dataclasses import dataclass

from barn_eval.experiments.ros_config import BAGS, PlannerLink
from barn_worlds.config import quantity


@dataclass(frozen=True)
class EvaluatorConfig(PlannerLink):
    """Parameters of the evaluator. Topics are renamed by remapping, as those of any node.

    Supervised, the evaluator was started by `barn`, which also starts the other nodes: what it is to do then comes from
    the file `assignment`, and the first group of parameters is not looked at.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity("0", "which of its worlds, such as 0, 0-49 or 0:300:6")
    planner: str = quantity("planner", "name that the planner has in the results")
    protocol: str = quantity("challenge", "name of the protocol, or a YAML file")
    seed: int = quantity(0, "seed of the run", minimum=0, maximum=2**62)
    repetitions: int = quantity(1, "trials per world", minimum=1, maximum=99)
    out: str = quantity("barn_out", "folder of the results; an equal experiment that was begun there is resumed")
    bags: str = quantity("all", "which trials keep a bag", choices=BAGS)
    simulator_node: str = quantity("simulator", "name of the simulator node; relative names are of this namespace")
    publish_map: bool = quantity(True, "publish the map, where the protocol gives one; a map server may do it instead")
    bag_exclude: tuple[str, ...] = quantity(("/parameter_events",), "topics that are not recorded")
    assignment: str = quantity("", "file of what to do, from the supervisor")
    supervisor_fd: int = quantity(-1, "socket to the supervisor, -1 for none", minimum=-1, maximum=1_000_000)
