"""Check in random episodes that contacts do not depend on a physics client's history.

    python qa/fidelity/check_motion.py --episodes 10000
    python qa/fidelity/check_motion.py --episodes 1000 --robot turtlebot4

Each episode is one robot, driven at random in a world of barn300: once with new physics
clients and once with those that all episodes before have used. The states must be equal
to the last bit after every control period.
"""

from contextlib import closing
from dataclasses import replace

import click
import numpy as np

from barn_sim.config import PRESETS, with_robot
from barn_sim.contact.scene import ScenePool
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot

STEPS = 120


def drive(seed: int, robot: Robot, scenes: ScenePool) -> list[bytes]:
    """Drive an episode and return the state after every control period.

    Args:
        seed: Decides the world, the start and the commands.
        robot: Robot that is driven.
        scenes: Physics clients for contacts.
    """
    rng = np.random.default_rng(seed)
    dataset = open_dataset("barn300")
    numbers = dataset.world_numbers
    world = dataset.load(numbers[rng.integers(len(numbers))])
    preset = with_robot(PRESETS["default"], robot)
    obstacles = replace(preset.obstacles, movable=bool(rng.integers(2)))
    config = replace(preset, obstacles=obstacles)
    x, y = world.path_m()[rng.integers(len(world.path))]
    start = Pose2D(x, y, rng.uniform(-3.1, 3.1))

    states = []
    with closing(Simulator(world, config, start, seed, scenes)) as simulator:
        for step in range(STEPS):
            if step % 12 == 0:
                command = Velocity2D(rng.uniform(-0.5, 1.5), rng.uniform(-2.0, 2.0))
            simulator.command(command)
            simulator.advance(10)
            moved = simulator.moved_obstacles()
            readings = (
                simulator.read_truth(),
                simulator.read_odometry(),
                simulator.read_collision(),
                simulator.read_joints(),
            )
            obstacles_state = moved.positions.tobytes() + moved.quaternions.tobytes()
            states.append(repr(readings).encode() + obstacles_state)
    return states


def find_difference(seed: int, robot: Robot, scenes: ScenePool) -> int | None:
    """Return the first step of an episode that depends on the clients, or None.

    Args:
        seed: Decides the episode.
        robot: Robot that is driven.
        scenes: Physics clients that have been used before.
    """
    with closing(ScenePool()) as new:
        expected = drive(seed, robot, new)
    states = drive(seed, robot, scenes)
    for step in range(STEPS):
        if states[step] != expected[step]:
            return step
    return None


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
    scenes = ScenePool()
    model = load_robot(robot)
    different = 0
    with click.progressbar(range(first, first + episodes)) as seeds:
        for seed in seeds:
            step = find_difference(seed, model, scenes)
            if step is not None:
                different += 1
                click.echo(f"\nepisode {seed} differs after step {step}")
    equal = episodes - different
    click.echo(
        f"{equal} of {episodes} episodes of {STEPS} steps are equal to the last bit"
    )
    raise SystemExit(1 if different else 0)


if __name__ == "__main__":
    main()
