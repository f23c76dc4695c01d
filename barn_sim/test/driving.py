"""Simple worlds, and robots driven there by commands, or at random to compare contacts."""

from contextlib import closing

import numpy as np

from barn_worlds.base.types import Velocity2D
from barn_worlds.worlds.world import World


def world_with(*filled, row=15, size=30):
    """Return a world of `size` by `size` cells, of which some are filled, with a path along a row."""
    grid = np.zeros((size, size), np.bool_)
    for cells in filled:
        grid[cells] = True
    return World("simple", grid, np.array([[row, column] for column in range(size)]))


def readings_of(simulator, commands):
    """Drive a simulator by commands, close it and return its first readings and those after each command."""
    with closing(simulator):
        return [simulator.sense(), *(simulator.step(command) for command in commands)]


def difference(estimate, truth):
    """Return an estimate's errors in x, y and yaw."""
    return estimate.x - truth.x, estimate.y - truth.y, estimate.yaw - truth.yaw


def wander(simulator, rng, steps):
    """Return all readings after every step, some of them parts of a control period, and how many ended freely."""
    states = []
    free = 0
    for step in range(steps):
        if step % 12 == 0:
            command = Velocity2D(rng.uniform(-0.5, 1.5), rng.uniform(-2.0, 2.0))
            simulator.command(command)
        simulator.advance(1 + step % 10)
        free += not simulator.motion.is_in_contact
        moved = simulator.moved_obstacles()
        states.append(
            (
                simulator.read_collision(),
                simulator.read_truth(),
                simulator.read_odometry(),
                simulator.read_joints(),
                simulator.read_scan().ranges.tobytes(),
                moved.positions.tobytes(),
                moved.quaternions.tobytes(),
            )
        )
    return states, free
