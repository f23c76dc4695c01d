"""Train a policy by PPO in generated worlds and show what it has learned, before against after, in those of barn300.

    python examples/train_policy.py --out out/policy

writes into that folder

    training.npz                   the worlds trained in
    policy.npz, untrained.npz      policy files for `barn run --planner policy --set policy_path=...`
    curve.csv, curve.png           return and success rate of the training's episodes over its steps

and prints the success rates of both policies in the held-out worlds, in trials as `barn run` makes them.
"""

import csv
import time
from collections import deque
from pathlib import Path

import click
import torch
from matplotlib.figure import Figure
from policy_training.stable_baselines import StableBatch, export_policy
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor

from barn_eval.analysis.summary import Summary, summarize
from barn_eval.learning.config import EnvConfig
from barn_eval.running.direct import run_direct_trial
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_planners.policy.space import PolicyAction, PolicyObservation
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate import DatasetParameters, write_dataset

RECENT = 400  # episodes that the curve is averaged over
RATE, LEAST_RATE = (
    5e-4,
    0.05,
)  # learning rate at first, and the share of it that is left in the end
COLUMNS = ("steps", "wall_s", "episodes", "success_rate", "mean_return", "mean_length")


class Curve(BaseCallback):
    """Prints and collects how the last episodes went, after every rollout."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[float, ...]] = []
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=RECENT)
        self._episodes = 0
        self._began = time.perf_counter()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self._episodes += 1
                self._recent.append(
                    (info["is_success"], info["episode"]["r"], info["episode"]["l"])
                )
        return True

    def _on_rollout_end(self) -> None:
        if not self._recent:
            return
        means = tuple(
            sum(column) / len(self._recent)
            for column in zip(*self._recent, strict=True)
        )
        self.rows.append(
            (
                self.num_timesteps,
                time.perf_counter() - self._began,
                self._episodes,
                *means,
            )
        )
        click.echo(
            "{:8d} steps {:5.0f} s {:6d} episodes: success {:.2f}, return {:7.2f}, length {:4.0f}".format(
                *self.rows[-1]
            )
        )


def train(
    config: EnvConfig, steps: int, seed: int, environments: int, out: Path
) -> Curve:
    """Train and write both policies; equal seeds give equal policies on equal machines."""
    torch.set_num_threads(1)  # these networks are too small for more
    worlds = VecMonitor(StableBatch(environments, config))
    model = PPO(
        "MlpPolicy",
        worlds,
        seed=seed,
        n_steps=8192 // environments,
        batch_size=2048,
        n_epochs=8,
        gamma=0.995,  # ten seconds
        learning_rate=lambda left: RATE * max(left, LEAST_RATE),
        policy_kwargs={"net_arch": [128, 128], "log_std_init": -0.5},
        device="cpu",
    )
    about = {"trained_in": open_dataset(config.dataset).checksum, "seed": seed}
    export_policy(model, config, out / "untrained.npz", about)
    curve = Curve()
    model.learn(steps, callback=curve)
    export_policy(model, config, out / "policy.npz", about)
    worlds.close()
    return curve


def evaluate(dataset: str, worlds: str, policy: Path, safety: bool) -> Summary:
    """Return the summary of a trial per world, the very trials of `barn run --planner policy --protocol challenge`."""
    protocol = load_protocol("challenge")
    planner = PlannerChoice(
        "policy", overrides={"policy_path": str(policy), "safety.enabled": safety}
    )
    experiment = RunConfig(
        dataset=dataset,
        worlds=worlds,
        planners=(planner,),
        protocol=protocol,
        simulator=simulator_config(protocol),
    )
    return summarize([run_direct_trial(trial).result for trial in experiment.trials()])


def draw(curve: Curve, path: Path) -> None:
    """Draw success rate and return over the steps."""
    steps, _, _, success, returns, _ = zip(*curve.rows, strict=True)
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(steps, success, color="#0072B2")
    above.set(ylabel=f"success rate\n(last {RECENT} episodes)", ylim=(0.0, 1.0))
    below.plot(steps, returns, color="#D55E00")
    below.set(ylabel="mean return", xlabel="steps")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def checksums(dataset: str | Path) -> set[str]:
    """Return the checksums of the worlds of a data set."""
    opened = open_dataset(dataset)
    return {opened.load(index).checksum for index in opened.world_numbers}


@click.command()
@click.option(
    "--steps",
    default=3_000_000,
    show_default=True,
    type=click.IntRange(1),
    help="Steps to train for.",
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
    help="Of Table I, to train in.",
)
@click.option(
    "--dataset", default="barn300", show_default=True, help="Data set to judge in."
)
@click.option(
    "--held-out", default="0:300:6", show_default=True, help="Which of its worlds."
)
@click.option(
    "--environments",
    default=64,
    show_default=True,
    type=click.IntRange(1, 256),
    help="Stepped together.",
)
@click.option(
    "--out",
    default=Path("out/policy"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
)
def main(
    steps: int,
    seed: int,
    worlds_per_set: int,
    dataset: str,
    held_out: str,
    environments: int,
    out: Path,
) -> None:
    """Train a policy and compare it with the untrained one."""
    write_dataset(
        out / "training.npz", DatasetParameters("training", seed, worlds_per_set)
    )
    if checksums(out / "training.npz") & checksums(dataset):
        raise click.UsageError(
            f"--seed {seed} generates worlds of {dataset} itself; take another"
        )
    config = EnvConfig(
        dataset=str(out / "training.npz"),
        observation=PolicyObservation(beams=40),
        action=PolicyAction(min_speed_mps=0.0, max_speed_mps=1.0),
    )
    curve = train(config, steps, seed, environments, out)
    with (out / "curve.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *curve.rows])
    if curve.rows:  # not so if no episode has ended
        draw(curve, out / "curve.png")
    for name, safety in (("untrained", False), ("policy", False), ("policy", True)):
        summary = evaluate(dataset, held_out, out / f"{name}.npz", safety)
        outcomes = ", ".join(
            f"{outcome} {count}" for outcome, count in summary.outcomes.items()
        )
        click.echo(
            f"{name}, {'with' if safety else 'without'} its shield, {summary.trials} held-out worlds: {outcomes}"
        )
        click.echo(
            f"    success {summary['success'].text(3)}, challenge metric {summary['challenge'].text(3)}"
        )


if __name__ == "__main__":
    main()
