"""The path: free, connected, limited in its turns, found whenever there is one, and like the published ones."""

import heapq
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.path_planner import inflation, plan_path, plan_through, search

CSPACES = npst.arrays(
    bool, st.tuples(st.integers(2, 10), st.integers(2, 10)), elements=st.booleans()
).map(
    lambda grid: grid & np.roll(grid, 1)  # sparser, so that more can be passed
)


STEPS = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]


def ends(cspace, data):
    free = np.argwhere(~cspace).tolist()
    if not free:
        return None
    pick = st.sampled_from(free).map(tuple)
    return data.draw(pick), data.draw(pick)


def turned_deg(before, after):
    if before is None:
        return 0.0
    turn = math.atan2(*after) - math.atan2(*before)
    return abs((math.degrees(turn) + 180.0) % 360.0 - 180.0)


def steps_from(cspace, cell, entered):
    """Yield the steps that a path may take from a cell that it has entered by a step, in the order of the original."""
    for down, right in STEPS:
        row, col = neighbor = cell[0] + down, cell[1] + right
        is_inside = 0 <= row < cspace.shape[0] and 0 <= col < cspace.shape[1]
        if not is_inside or cspace[neighbor]:
            continue
        between_walls = down and right and cspace[cell[0], col] and cspace[row, cell[1]]
        if not between_walls and turned_deg(entered, (down, right)) <= 46.0:
            yield down, right


def plain_shortest(cspace, start, goal):
    """Length of the shortest path by Dijkstra over (cell, direction), None if there is none."""
    queue = [(0.0, 0, start, None)]
    done = set()
    tie = itertools.count(1)
    while queue:
        cost, _, cell, entered = heapq.heappop(queue)
        if cell == goal:
            return cost
        if (cell, entered) in done:
            continue
        done.add((cell, entered))
        for step in steps_from(cspace, cell, entered):
            neighbor = cell[0] + step[0], cell[1] + step[1]
            heapq.heappush(queue, (cost + math.hypot(*step), next(tie), neighbor, step))
    return None


@given(CSPACES, st.data())
def test_paths_are_free_connected_and_limited_in_their_turns(cspace, data):
    if (picked := ends(cspace, data)) is None:
        return
    start, goal = picked
    path = plan_path(cspace, start, goal)
    assert (path is None) == (plain_shortest(cspace, start, goal) is None)
    if path is None:
        return
    assert tuple(path[0]) == start
    assert tuple(path[-1]) == goal
    assert not cspace[tuple(path.T)].any()
    steps = np.diff(path, axis=0)
    assert (np.abs(steps).max(axis=1, initial=0) == 1).all()
    turns_deg = [turned_deg(*both) for both in itertools.pairwise(steps)]
    assert max(turns_deg, default=0.0) <= 45.0 + 1e-6
    for (r0, c0), (r1, c1) in itertools.pairwise(path):
        assert not (r0 != r1 and c0 != c1 and cspace[r0, c1] and cspace[r1, c0])
    assert np.array_equal(path, plan_path(cspace, start, goal))


@given(CSPACES, st.data())
def test_without_inflation_the_complete_search_is_shortest(cspace, data):
    if (picked := ends(cspace, data)) is None:
        return
    first, last = (row * cspace.shape[1] + column for row, column in picked)
    path = search(~cspace, np.zeros(cspace.shape), first, last, True)
    shortest = plain_shortest(cspace, *picked)
    assert (len(path) == 0) == (shortest is None)
    if shortest is not None:
        lengths = np.hypot(*np.diff(path, axis=0).T)
        assert lengths.sum() == pytest.approx(shortest)


@given(CSPACES)
def test_inflation_falls_with_obstacle_distance(cspace):
    occupied = np.argwhere(cspace)
    costs = inflation(cspace)
    for cell in np.argwhere(~cspace):
        distance = np.hypot(*(occupied - cell).T).min(initial=np.inf)
        expected = 5.0 / distance if distance <= 2.0 else 0.0
        assert costs[tuple(cell)] == pytest.approx(expected)


def plain_original(cspace, start, goal, penalty):
    """The original's search over a plain list of open cells, of which the first of the lowest priority is taken."""
    cost = {start: 0.0}
    parent = {start: None}
    entered = {start: None}
    open_ = {start: (0.0, 0)}
    closed = set()
    while open_:
        cell = min(open_, key=open_.get)
        del open_[cell]
        closed.add(cell)
        if cell == goal:
            path = []
            while cell is not None:
                path.append(cell)
                cell = parent[cell]
            return path[::-1]
        for number, (down, right) in enumerate(steps_from(cspace, cell, entered[cell])):
            neighbor = cell[0] + down, cell[1] + right
            new_cost = cost[cell] + math.hypot(down, right)
            if neighbor in closed or new_cost >= cost.get(neighbor, math.inf):
                continue
            priority = new_cost + penalty[neighbor]
            if neighbor in open_:
                priority += math.dist(neighbor, goal)
            cost[neighbor] = new_cost
            parent[neighbor] = cell
            entered[neighbor] = (down, right)
            open_[neighbor] = priority, (len(closed), number)
    return None


@given(CSPACES, st.data())
def test_the_original_search_is_that_of_a_plain_list(cspace, data):
    if (picked := ends(cspace, data)) is None:
        return
    plain = plain_original(cspace, *picked, inflation(cspace))
    path = plan_path(cspace, *picked)
    if plain is not None:
        assert list(map(tuple, path.tolist())) == plain


def test_paths_repeat_the_published_ones_cell_by_cell(original_folder):
    dataset = open_dataset(original_folder)
    assert len(dataset.world_numbers) > 0
    for index in dataset.world_numbers:
        world = dataset.load(index)
        path = plan_path(world.cspace, world.path[0], world.path[-1])
        # the first cell is there twice
        assert np.array_equal(path, world.path[1:]), index


def test_ends_that_are_occupied_or_outside():
    cspace = np.zeros((3, 3), bool)
    cspace[0, 0] = True
    assert plan_path(cspace, (0, 0), (2, 2)) is None
    with refused(r"cell \(3, 0\) is outside the grid of 3 x 3", WorldError):
        plan_path(cspace, (3, 0), (2, 2))


def test_the_middle_of_the_passage_is_the_default():
    cspace = np.zeros((9, 6), bool)
    cspace[[0, -1]] = True
    path = plan_through(cspace)
    assert path.tolist() == [[4, column] for column in range(6)]
    cspace[:, 3] = True
    assert plan_through(cspace) is None
