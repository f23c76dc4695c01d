"""Where the obstacles of a built course stand, by the scans of a drive through it.

Poses of the lidar and centers of cylinders are adjusted together until the returns of
all scans lie on the cylinders (a bundle adjustment by Gauss-Newton steps). Odometry
only says where to begin. Scans alone do not say where the course as a whole lies: that
is fixed by the true poses of the bag or, without any, by the plan.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from barn_eval.results.bags.recorded import MAP, RecordedTrial
from barn_worlds.base.arrays import Floats, Integers, Points
from barn_worlds.base.errors import BagError
from barn_worlds.base.types import Pose2D, Scan
from barn_worlds.worlds.world import World

# A scan counts once the robot has moved or turned so far since the last one that does.
_STEP_M = 0.08
_STEP_RAD = 0.1
_MOST_SCANS = 300
_FARTHEST_M = 8.0

# How far from a cylinder its returns may lie, step by step.
_FIRST_GATES_M = (0.10, 0.10, 0.07, 0.07, 0.05, 0.05)
_GATES_M = (0.06, 0.06, 0.05, 0.05, 0.04, 0.04, 0.04, 0.04)
# How far they must lie from any other one, and the least cosine of the angle at which
# a ray meets the surface: where it grazes, it may belong to what stands behind.
_OTHER_M = 0.03
_LEAST_SLANT = 0.35
_LEAST_RETURNS = 20
_LEAST_SHARE = 0.9

# Within these limits, positions are good to 3 mm. Beyond the second one, returns may
# count for a neighbor.
_LARGEST_ERROR_M = 0.001
_LARGEST_OFFSET_M = 0.05


class _Returns(NamedTuple):
    scans: Integers  # (n,) number of the scan
    angles: Floats  # in the lidar's frame
    ranges_m: Floats


class _Matches(NamedTuple):
    """Returns that belong to a cylinder, and how far its surface is."""

    scans: Integers
    cylinders: Integers
    errors_m: Floats
    normals: Points
    levers_m: Floats  # by how much a turn of the lidar moves the return off the surface
    slants: Floats  # cosine of the angle between ray and normal
    near_share: float  # of all returns within the world, that are near a cylinder


@dataclass(frozen=True, eq=False)
class Survey:
    """The cylinders of a course as built, in the order of `World.planned_m`."""

    world: World  # as planned
    centers_m: Points
    # Standard error of each position among the others.
    errors_m: Floats
    returns: Integers
    # What fixes the course as a whole.
    datum: str

    @property
    def offsets_m(self) -> Points:
        """How far each cylinder stands from its place in the plan."""
        return self.centers_m - self.world.planned_m

    def entries(self) -> list[dict[str, Any]]:
        """Return number, plan, offset, error and doubt of each, as plain data."""
        entries = []
        for number, (x, y) in enumerate(self.world.planned_m.tolist()):
            dx_mm, dy_mm = (1000.0 * self.offsets_m[number]).tolist()
            entry = {
                "number": number,
                "x_m": x,
                "y_m": y,
                "dx_mm": dx_mm,
                "dy_mm": dy_mm,
                "off_mm": math.hypot(dx_mm, dy_mm),
                "error_mm": 1000.0 * float(self.errors_m[number]),
                "returns": int(self.returns[number]),
                "unsure": self.doubts.get(number, ""),
            }
            entries.append(entry)
        return entries

    @cached_property
    def doubts(self) -> dict[int, str]:
        """Why positions are unsure, by place in `centers_m`."""
        doubts = {}
        offsets_m = np.hypot(*self.offsets_m.T)
        for place, error_m in enumerate(self.errors_m.tolist()):
            if not self.returns[place]:
                doubts[place] = "not seen"
            elif offsets_m[place] > _LARGEST_OFFSET_M:
                doubts[place] = "too far from its place to be told from its neighbors"
            elif error_m > _LARGEST_ERROR_M:
                doubts[place] = "seen too little"
        return doubts

    def built_world(self) -> World:
        """Return the world as built; what is unsure stands as planned."""
        built_m = self.centers_m.copy()
        unsure = list(self.doubts)
        built_m[unsure] = self.world.planned_m[unsure]
        return replace(self.world, built_m=built_m)


def survey_course(
    trial: RecordedTrial, world: World, start: Pose2D, tolerance_m: float
) -> Survey:
    """Return where the cylinders of a course stand, by a drive's scans.

    Args:
        trial: The drive, with odometry and scans.
        world: The plan.
        start: Pose of base_link in the map frame at the first pose of the drive, where
            the bag has no true poses.
        tolerance_m: Standard deviation of misplacements, as expected.

    Raises:
        BagError: If the bag has no scans, or they do not fit the plan.
    """
    returns, places = _select_scans(trial)
    has_truth = trial.frame == MAP
    motions = trial.odometry
    if has_truth:
        motions = trial.poses
        start = Pose2D(*motions[0].tolist())
    plan_m = world.planned_m

    # First by the plan, scan after scan, so that no error of the odometry adds up.
    poses = np.empty((len(places), 3))
    pose = start @ trial.lidar
    last = Pose2D(*motions[0].tolist()) @ trial.lidar
    for number, place in enumerate(places):
        lidar = Pose2D(*motions[place].tolist()) @ trial.lidar
        pose = pose @ last.inverse() @ lidar
        last = lidar
        poses[number] = (pose.x, pose.y, pose.yaw)
        _locate(returns, number, poses, world)
        pose = Pose2D(*poses[number].tolist())

    # Then poses and cylinders together.
    first = poses.size
    centers_m = plan_m.copy()
    noise_m = 0.01
    for gate_m in _GATES_M:
        matches = _match(returns, poses, centers_m, world, gate_m)
        share = matches.near_share
        if share < _LEAST_SHARE:
            raise BagError(
                f"{trial.name}: its scans do not fit {world.name}: {share:.0%} of"
                f" returns in it are near an obstacle, {_LEAST_SHARE:.0%} must be; name"
                " the world it was driven in, and --course if it began elsewhere"
            )
        information, gradient = _normal_equations(
            matches, len(poses), len(plan_m), noise_m
        )
        prior = tolerance_m**-2
        information[range(first, len(gradient)), range(first, len(gradient))] += prior
        gradient[first:] += prior * (centers_m - plan_m).ravel()
        step = np.linalg.solve(information, gradient)
        poses -= step[:first].reshape(-1, 3)
        centers_m -= step[first:].reshape(-1, 2)
        # The median is that of a normal distribution, however far off some are.
        noise_m = 1.4826 * float(np.median(np.abs(matches.errors_m / matches.slants)))

    datum = "plan"
    if has_truth:
        datum = "true poses"
        true_m = []
        for row in trial.poses[places].tolist():
            pose = Pose2D(*row) @ trial.lidar
            true_m.append((pose.x, pose.y))
        centers_m = _fit(poses[:, :2], np.array(true_m)).transform(centers_m)
    counts = np.bincount(matches.cylinders, minlength=len(plan_m))
    covariance = np.asarray(np.linalg.inv(information), np.float64)[first:, first:]
    errors_m = _standard_errors(covariance, centers_m, counts)
    return Survey(world, centers_m, errors_m, counts, datum)


def _select_scans(trial: RecordedTrial) -> tuple[_Returns, list[int]]:
    """Return the returns of scans that are apart, and the place of each scan's pose.

    Raises BagError if there are none.
    """
    last = Pose2D(np.inf, np.inf, 0.0)
    chosen: list[tuple[Scan, int]] = []
    for item in trial.scans:
        place = trial.index_at(item.time_s)
        pose = Pose2D(*trial.poses[place].tolist())
        turn = abs((last.inverse() @ pose).yaw) if chosen else np.inf
        if pose.distance(last) > _STEP_M or turn > _STEP_RAD:
            last = pose
            chosen.append((item.content, place))
    chosen = chosen[:: 1 + len(chosen) // _MOST_SCANS]
    parts = []
    for number, (scan, _) in enumerate(chosen):
        ranges_m = scan.ranges.astype(np.float64)
        farthest_m = min(scan.range_max, _FARTHEST_M)
        is_hit = (ranges_m > scan.range_min) & (ranges_m < farthest_m)
        angles = scan.angles()[is_hit]
        parts.append(_Returns(np.full(len(angles), number), angles, ranges_m[is_hit]))
    if not parts:
        raise BagError(f"{trial.name}: no scans on /scan to survey by")
    columns = map(np.concatenate, zip(*parts, strict=True))
    return _Returns(*columns), [place for _, place in chosen]


def _locate(returns: _Returns, number: int, poses: Floats, world: World) -> None:
    """Improve the pose of one scan, in place, by what it sees of the plan."""
    is_own = returns.scans == number
    scan = _Returns(
        returns.scans[is_own], returns.angles[is_own], returns.ranges_m[is_own]
    )
    for gate_m in _FIRST_GATES_M:
        matches = _match(scan, poses, world.planned_m, world, gate_m)
        if len(matches.scans) >= _LEAST_RETURNS:
            jacobian = np.column_stack([matches.normals, matches.levers_m])
            step, *_ = np.linalg.lstsq(jacobian, matches.errors_m)
            poses[number] -= step


def _match(
    returns: _Returns, poses: Floats, centers_m: Points, world: World, gate_m: float
) -> _Matches:
    """Return the returns that can only belong to one cylinder, within a gate."""
    angles = poses[returns.scans, 2] + returns.angles
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets_m = rays * returns.ranges_m[:, None]
    points_m = offsets_m + poses[returns.scans, :2]
    distances_m, nearest = KDTree(centers_m).query(points_m, k=2)
    cylinders = nearest[:, 0]
    errors_m = distances_m[:, 0] - world.cylinder_radius_m
    normals = (points_m - centers_m[cylinders]) / distances_m[:, :1]
    levers_m = offsets_m[:, 0] * normals[:, 1] - offsets_m[:, 1] * normals[:, 0]
    slants = -(normals * rays).sum(axis=1)

    is_near = np.abs(errors_m) < gate_m
    other_m = distances_m[:, 1] - world.cylinder_radius_m
    is_clear = other_m > np.maximum(_OTHER_M, 2.0 * np.abs(errors_m))
    kept = is_near & is_clear & (slants > _LEAST_SLANT)
    low_x, low_y, high_x, high_y = world.bounds_m
    is_inside = (points_m > (low_x, low_y)) & (points_m < (high_x, high_y))
    is_near_inside = is_near[is_inside.all(axis=1)]
    near_share = float(is_near_inside.sum()) / max(1, len(is_near_inside))
    return _Matches(
        returns.scans[kept],
        cylinders[kept],
        errors_m[kept],
        normals[kept],
        levers_m[kept],
        slants[kept],
        near_share,
    )


def _normal_equations(
    matches: _Matches, scans: int, cylinders: int, noise_m: float
) -> tuple[Floats, Floats]:
    """Return information (k, k) and gradient (k,) of poses, then centers."""
    count = len(matches.scans)
    first = 3 * scans
    pose = 3 * matches.scans
    center = first + 2 * matches.cylinders
    columns = np.concatenate([pose, pose + 1, pose + 2, center, center + 1])
    x, y = matches.normals.T
    values = np.concatenate([x, y, matches.levers_m, -x, -y])
    jacobian = csr_matrix(
        (values, (np.tile(np.arange(count), 5), columns)),
        shape=(count, first + 2 * cylinders),
    )
    # Noise is along the ray. What is far off counts less (Cauchy's weights).
    deviations_m = noise_m * matches.slants
    weights = deviations_m**-2 / (1.0 + (matches.errors_m / (3.0 * deviations_m)) ** 2)
    weighted = jacobian.multiply(weights[:, None]).tocsr()
    information = (jacobian.T @ weighted).toarray()
    # A pose that nothing is seen from stays where it is.
    information[range(first), range(first)] += 1e-3
    return information, weighted.T @ matches.errors_m


def _fit(points_m: Points, targets_m: Points) -> Pose2D:
    """Return the rigid motion that brings points (n, 2) next to targets (n, 2)."""
    center_m = points_m.mean(axis=0)
    target_m = targets_m.mean(axis=0)
    x, y = (points_m - center_m).T
    target_x, target_y = (targets_m - target_m).T
    yaw = np.arctan2(
        (x * target_y - y * target_x).sum(), (x * target_x + y * target_y).sum()
    )
    turn = Pose2D(0.0, 0.0, float(yaw))
    shift_x, shift_y = (target_m - turn.transform(center_m[None])[0]).tolist()
    return Pose2D(shift_x, shift_y, turn.yaw)


def _standard_errors(
    covariance: Floats, centers_m: Points, returns: Integers
) -> Floats:
    """Return the larger standard error (n,) of each center among those that are seen."""
    # Shift and turn of the whole course are the datum's, so they are projected out.
    x, y = centers_m.T
    motions = np.zeros((len(covariance), 3))
    motions[0::2, 0] = 1.0
    motions[1::2, 1] = 1.0
    motions[0::2, 2] = -y
    motions[1::2, 2] = x
    is_seen = np.repeat(returns >= _LEAST_RETURNS, 2)
    projection = np.eye(len(covariance))
    projection[:, is_seen] -= motions @ np.linalg.pinv(motions[is_seen])
    relative = projection @ covariance @ projection.T
    places = np.arange(len(x))
    blocks = relative.reshape(len(x), 2, len(x), 2)[places, :, places]
    errors_m: Floats = np.sqrt(np.linalg.eigvalsh(blocks)[:, -1])
    return errors_m
