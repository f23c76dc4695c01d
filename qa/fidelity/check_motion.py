"""Compare free motion with PyBullet's, tick by tick, in random episodes.

    python qa/fidelity/check_motion.py --episodes 10000
    python qa/fidelity/check_motion.py --episodes 1000 --robot turtlebot4

Each episode is one robot, driven at random in a world of barn300, once with every tick left to PyBullet and once as
simulators do it by default. Their states must be equal to the last bit after every control period.
"""

from collections.abc import Iterator
from dataclasses import replace

import click
import numpy as np

from barn_sim.config import PRESETS, with_robot
from barn_sim.contact.bullet import PhysicsClient
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot

STEPS = 120


def episode(
    seed: int, robot: Robot, client: PhysicsClient, *, free_motion: bool
) -> Iterator[bytes]:
    """Yield the state after every step of an episode as bytes, which decides the world, the start and the commands."""
    rng = np.random.default_rng(seed)
    dataset = open_dataset("barn300")
    world = dataset.load(
        dataset.world_numbers[rng.integers(len(dataset.world_numbers))]
    )
    preset = with_robot(PRESETS["default"], robot)
    config = replace(
        preset, obstacles=replace(preset.obstacles, movable=bool(rng.integers(2)))
    )
    x, y = world.path_m()[rng.integers(len(world.path))]
    simulator = Simulator(
        world,
        config,
        Pose2D(x, y, rng.uniform(-3.1, 3.1)),
        seed,
        client,
        free_motion=free_motion,
    )
    command = Velocity2D()
    for step in range(STEPS):
        if step % 12 == 0:
            command = Velocity2D(rng.uniform(-0.5, 1.5), rng.uniform(-2.0, 2.0))
        simulator.command(command)
        simulator.advance(10)
        moved = simulator.moved_obstacles()
        truth = simulator.read_truth()
        odometry = simulator.read_odometry()
        said = repr(
            (truth, odometry, simulator.read_collision(), simulator.read_joints())
        ).encode()
        yield said + moved.positions.tobytes() + moved.quaternions.tobytes()


def first_difference(
    seed: int, robot: Robot, clients: tuple[PhysicsClient, PhysicsClient]
) -> int | None:
    """Return the first step of an episode after which the two ways differ, None if they never do."""
    ways = (
        episode(seed, robot, client, free_motion=free)
        for client, free in zip(clients, (False, True), strict=True)
    )
    return next(
        (
            step
            for step, (one, other) in enumerate(zip(*ways, strict=True))
            if one != other
        ),
        None,
    )


@click.command()
@click.option(
    "--episodes",
    default=10_000,
    show_default=True,
    type=click.IntRange(1),
    help="How many.",
)
@click.option(
    "--first",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Seed of the first.",
)
@click.option(
    "--robot", default="jackal", show_default=True, help="Name or file of a robot."
)
def main(episodes: int, first: int, robot: str) -> None:
    """Compare episodes and exit with 1 if any differs."""
    clients = (PhysicsClient(), PhysicsClient())
    different = 0
    driven = load_robot(robot)
    with click.progressbar(range(first, first + episodes)) as seeds:
        for seed in seeds:
            step = first_difference(seed, driven, clients)
            if step is not None:
                different += 1
                click.echo(f"\nepisode {seed} differs after step {step}")
    click.echo(
        f"{episodes - different} of {episodes} episodes of {STEPS} steps are equal to the last bit"
    )
    raise SystemExit(1 if different else 0)


if __name__ == "__main__":
    main()
