"""The generated parts of README.md and config: commands, protocols, and parameters of the evaluator."""

from barn_eval.commands.main import COMMANDS
from barn_eval.experiments.ros_config import RosSetup
from barn_eval.ros.evaluator_config import EvaluatorConfig
from barn_eval.trials.protocol import PROTOCOLS
from barn_worlds.reference import Reference, parameter_file, parameter_table, table


def reference() -> Reference:
    """Return the tables and the parameter file; what only a supervisor sets is left out of the file."""
    evaluator = EvaluatorConfig()
    sections = {
        "commands": table(["command", ""], [[f"`barn {name}`", summary] for name, summary in COMMANDS.items()]),
        "protocols": parameter_table(PROTOCOLS),
        "ros settings": parameter_table({"default": RosSetup()}),
        "evaluator parameters": parameter_table({"default": evaluator}),
    }
    title = "The evaluator with its defaults."
    file = parameter_file("/**/evaluator", title, [evaluator], leave_out=["assignment", "supervisor_fd"])
    return Reference(sections, {"evaluator.yaml": file})
