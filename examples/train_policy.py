"""Train a policy by PPO in generated worlds and test it in others.

    python examples/train_policy.py --out out/policy
    python examples/train_policy.py --task moving --out out/movers

The task is `static`, worlds as those of barn300, or `moving`, arenas as those of
dynabarn60. The script writes into the folder

    training.npz                   worlds of the training
    policy.npz, untrained.npz      policies after and before it, for
                                   `barn run --planner policy --set policy_path=...`
    curve.csv, curve.png           return and success rate of episodes over the steps

and prints the success rates of both policies in the held-out worlds, in trials as
`barn run` makes them.
"""

import csv
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
import torch
from matplotlib.figure import Figure
from policy_training.stable_baselines import StableBatch, export_policy
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor

import barn_eval as barn
from barn_eval.analysis.summary import Summary, summarize
from barn_eval.learning.config import EnvConfig, RewardConfig
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_planners.policy.collision_check import CollisionCheckConfig
from barn_planners.policy.file import read_policy
from barn_planners.policy.space import PolicyAction, PolicyObservation
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate import DatasetParameters, write_dataset


@dataclass(frozen=True)
class Task:
    """What is trained, and where it is judged."""

    protocol: str
    held_out: str
    """Data set to judge in."""

    held_out_worlds: str
    steps: int
    observation: PolicyObservation
    action: PolicyAction
    reward: RewardConfig


# An action holds for 0.1 s, so rewards of ten seconds ahead count.
DISCOUNT = 0.99
TASKS = {
    "static": Task(
        "challenge",
        "barn300",
        "0:300:6",
        6_000_000,
        # Three frames, 0.4 s apart, are a memory of a dead end.
        PolicyObservation(beams=40, frames=3, frame_steps=4),
        PolicyAction(min_speed_mps=0.0, max_speed_mps=1.0, repeat=2),
        RewardConfig(discount=DISCOUNT),
    ),
    "moving": Task(
        "dynabarn",
        "dynabarn60",
        "all",
        800_000,
        # Three frames, 0.2 s apart, show how obstacles move.
        PolicyObservation(
            beams=60, range_limit_m=8.0, goal_limit_m=20.0, frames=3, frame_steps=2
        ),
        PolicyAction(min_speed_mps=-1.0, max_speed_mps=2.0, repeat=2),
        # At -10, standing until time is up, 30 s ahead, costs a beginner less than
        # driving into an obstacle soon.
        RewardConfig(discount=DISCOUNT, collision=-4.0),
    ),
}
# Episodes that the curve is averaged over.
WINDOW = 400
# Rollouts after which the policy is saved.
SAVING_PERIOD = 20
# Learning rate at first, and the share of it that remains at the end.
LEARNING_RATE = 5e-4
FINAL_SHARE = 0.05
# Of a policy that goes on from another one: learning rate, logarithm of the spread of its
# actions, and steps in which only the critic learns.
FINE_LEARNING_RATE = 2e-4
FINE_LOG_STD = -1.2
CRITIC_STEPS = 65_536


class CurveRow(NamedTuple):
    """The state of the training after a rollout; the means are of the last episodes."""

    steps: int
    wall_s: float
    episodes: int
    success_rate: float
    mean_return: float
    mean_length: float


class Curve(BaseCallback):
    """Prints and collects the results of the last episodes after every rollout."""

    def __init__(self, save: Callable[[], object]) -> None:
        """Keep what writes the policy, so that a training that is broken off has one."""
        super().__init__()
        self.rows: list[CurveRow] = []
        self._save = save
        self._successes: deque[bool] = deque(maxlen=WINDOW)
        self._returns: deque[float] = deque(maxlen=WINDOW)
        self._lengths: deque[int] = deque(maxlen=WINDOW)
        self._episodes = 0
        self._start_s = time.perf_counter()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self._episodes += 1
                self._successes.append(info["is_success"])
                self._returns.append(info["episode"]["r"])
                self._lengths.append(info["episode"]["l"])
        return True

    def _on_rollout_end(self) -> None:
        count = len(self._successes)
        if count == 0:
            return
        row = CurveRow(
            self.num_timesteps,
            time.perf_counter() - self._start_s,
            self._episodes,
            sum(self._successes) / count,
            sum(self._returns) / count,
            sum(self._lengths) / count,
        )
        self.rows.append(row)
        if len(self.rows) % SAVING_PERIOD == 0:
            self._save()
        click.echo(
            f"{row.steps:8d} steps {row.wall_s:5.0f} s {row.episodes:6d} episodes: "
            f"success {row.success_rate:.2f}, return {row.mean_return:7.2f}, "
            f"length {row.mean_length:4.0f}"
        )


def start_from(model: PPO, config: EnvConfig, path: Path) -> None:
    """Set the actor of a model to a policy that has fewer frames, or as many.

    Args:
        model: Model with layers of the policy's sizes.
        config: Environment of the model.
        path: Policy file; its frames are the newest ones of the model's observations.
    """
    policy = read_policy(path)
    kept = ("frames", "frame_steps")
    changes = {name: getattr(config.observation, name) for name in kept}
    same_frame = replace(policy.observation, **changes) == config.observation
    same_action = replace(policy.action, repeat=config.action.repeat) == config.action
    if not same_frame or not same_action or policy.activation != "tanh":
        raise click.UsageError(f"{path}: sees or acts otherwise than the task says")

    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net][::2]
    with torch.no_grad():
        for layer, weights, biases in zip(
            layers, policy.weights, policy.biases, strict=True
        ):
            # Older frames count nothing at first.
            layer.weight.zero_()
            layer.weight[:, : len(weights)] = torch.from_numpy(weights.T.copy())
            layer.bias.copy_(torch.from_numpy(biases))
        model.policy.log_std.fill_(FINE_LOG_STD)


class HeldActor(BaseCallback):
    """Holds the actor still until the critic knows what its actions are worth."""

    def _on_rollout_start(self) -> None:
        policy = self.model.policy
        is_free = self.num_timesteps >= CRITIC_STEPS
        policy.log_std.requires_grad_(is_free)
        for module in (policy.mlp_extractor.policy_net, policy.action_net):
            module.requires_grad_(is_free)

    def _on_step(self) -> bool:
        return True


def train(
    config: EnvConfig,
    steps: int,
    seed: int,
    environments: int,
    out: Path,
    start: Path | None = None,
) -> Curve:
    """Train a policy and write it, as well as the untrained one.

    Equal seeds give equal policies on equal machines.

    Args:
        config: Environment to train in.
        steps: Number of environment steps.
        seed: Seed of everything random.
        environments: Number of environments that step together.
        out: Folder for both policy files.
        start: Policy file to start from; by default the networks are random.

    Returns:
        Results of the episodes over the steps.
    """
    # These networks are too small for more than one thread.
    torch.set_num_threads(1)
    batch = VecMonitor(StableBatch(environments, config))
    rate = LEARNING_RATE if start is None else FINE_LEARNING_RATE
    model = PPO(
        "MlpPolicy",
        batch,
        seed=seed,
        n_steps=8192 // environments,
        batch_size=2048,
        n_epochs=6,
        # The discount by which progress is shaped must be the learner's own.
        gamma=config.reward.discount,
        learning_rate=lambda remaining: rate * max(remaining, FINAL_SHARE),
        policy_kwargs={"net_arch": [128, 128], "log_std_init": -0.5},
        device="cpu",
    )
    callbacks: list[BaseCallback] = []
    if start is not None:
        start_from(model, config, start)
        callbacks.append(HeldActor())
    description = {"trained_in": open_dataset(config.dataset).checksum, "seed": seed}
    export_policy(model, config, out / "untrained.npz", description)
    save = partial(export_policy, model, config, out / "policy.npz", description)
    curve = Curve(save)
    model.learn(steps, callback=[*callbacks, curve])
    save()
    batch.close()
    return curve


def evaluate(
    protocol_name: str, dataset: str, worlds: str, policy: Path, safety: bool
) -> Summary:
    """Return the summary of one trial per world, as `barn run` makes them.

    Args:
        protocol_name: Rules of the trials.
        dataset: Data set of the worlds.
        worlds: Which of its worlds, such as "0:300:6".
        policy: Policy file.
        safety: Whether the collision check is on.
    """
    protocol = load_protocol(protocol_name)
    overrides = {"policy_path": str(policy), "safety.enabled": safety}
    run_config = RunConfig(
        dataset=dataset,
        worlds=worlds,
        planners=(PlannerChoice("policy", overrides=overrides),),
        protocol=protocol,
        simulator=simulator_config(protocol),
    )
    return summarize([run_direct_trial(trial).result for trial in run_config.trials()])


def draw(curve: Curve, path: Path) -> None:
    """Draw success rate and return over the steps.

    Args:
        curve: Results of at least one rollout.
        path: Image to write.
    """
    steps = [row.steps for row in curve.rows]
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    success_axes, return_axes = figure.subplots(2, 1, sharex=True)
    success_axes.plot(steps, [row.success_rate for row in curve.rows], color="#0072B2")
    success_axes.set(ylabel=f"success rate\n(last {WINDOW} episodes)", ylim=(0.0, 1.0))
    return_axes.plot(steps, [row.mean_return for row in curve.rows], color="#D55E00")
    return_axes.set(ylabel="mean return", xlabel="steps")
    for axes in (success_axes, return_axes):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def generate_worlds(path: Path, task: str, seed: int, per_set: int) -> None:
    """Write a data set of worlds to train in.

    Args:
        path: File to write.
        task: Name of the task.
        seed: Seed of the worlds.
        per_set: Worlds for each of the twelve sets of Table I, or each class of speed.
    """
    if task == "static":
        write_dataset(path, DatasetParameters("training", seed, per_set))
        return
    classes = ["easy", "medium", "hard"]
    barn.worlds.generate_moving(path, classes, seed=seed, per_class=per_set)


def checksums(name: str | Path) -> set[str]:
    """Return the checksums of the worlds of a data set."""
    dataset = open_dataset(name)
    return {dataset.load(number).checksum for number in dataset.world_numbers}


@click.command()
@click.option(
    "--task",
    "task_name",
    default="static",
    show_default=True,
    type=click.Choice(list(TASKS)),
    help="What to train.",
)
@click.option(
    "--steps",
    default=None,
    type=click.IntRange(1),
    help="Steps to train for; by default as many as the recipe says.",
)
@click.option(
    "--seed",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Seed of everything random.",
)
@click.option(
    "--worlds-per-set",
    default=100,
    show_default=True,
    type=click.IntRange(1, 1000),
    help="Worlds to train in, of each set of Table I or each class of speed.",
)
@click.option("--dataset", default=None, help="Data set to judge in.")
@click.option("--held-out", default=None, help="Which of its worlds.")
@click.option(
    "--environments",
    default=64,
    show_default=True,
    type=click.IntRange(1, 256),
    help="Stepped together.",
)
@click.option(
    "--start",
    default=None,
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Policy file to start from, with fewer frames or as many.",
)
@click.option("--collision-check", is_flag=True, help="Train with the check on.")
@click.option(
    "--out",
    default=Path("out/policy"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
)
def main(
    task_name: str,
    steps: int | None,
    seed: int,
    worlds_per_set: int,
    dataset: str | None,
    held_out: str | None,
    environments: int,
    start: Path | None,
    collision_check: bool,
    out: Path,
) -> None:
    """Train a policy and compare it with the untrained one."""
    task = TASKS[task_name]
    dataset = dataset or task.held_out
    held_out = held_out or task.held_out_worlds
    out.mkdir(parents=True, exist_ok=True)
    training = out / "training.npz"
    generate_worlds(training, task_name, seed, worlds_per_set)
    if checksums(training) & checksums(dataset):
        raise click.UsageError(
            f"--seed {seed} generates worlds of {dataset} itself; take another"
        )
    config = EnvConfig(
        dataset=str(training),
        protocol=task.protocol,
        observation=task.observation,
        action=task.action,
        safety=CollisionCheckConfig(enabled=collision_check),
        reward=task.reward,
    )
    curve = train(config, steps or task.steps, seed, environments, out, start)
    with (out / "curve.csv").open("w", newline="") as file:
        csv.writer(file).writerows([CurveRow._fields, *curve.rows])
    # A short training may end before its first episode does.
    if curve.rows:
        draw(curve, out / "curve.png")

    for name, safety in (("untrained", False), ("policy", False), ("policy", True)):
        policy = out / f"{name}.npz"
        summary = evaluate(task.protocol, dataset, held_out, policy, safety)
        counts = [f"{outcome} {count}" for outcome, count in summary.outcomes.items()]
        check = "with" if safety else "without"
        success = summary["success"].text(3)
        challenge = summary["challenge"].text(3)
        click.echo(
            f"{name}, {check} collision check, {summary.trials} held-out worlds: "
            f"{', '.join(counts)}"
        )
        click.echo(f"    success {success}, challenge metric {challenge}")


if __name__ == "__main__":
    main()
