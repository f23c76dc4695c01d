"""Locate the obstacles of a built course from the scans of a drive through it.

Poses of the lidar and centers of cylinders are adjusted together until the returns of
all scans lie on the cylinders (a bundle adjustment by Gauss-Newton steps). Odometry
only gives the initial poses. Scans alone do not show where the course as a whole lies:
poses in the world's frame or, without them, the plan fix it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from barn_eval.results.bags.recorded import RecordedTrial
from barn_eval.results.bags.sources import FIXED_FRAMES
from barn_worlds.base.arrays import Floats, Integers, Points, unit_vectors
from barn_worlds.base.errors import BagError
from barn_worlds.base.types import Pose2D, Scan
from barn_worlds.messages import topics
from barn_worlds.worlds.world import World

# A scan is used if the robot has moved or turned this far since the last used scan.
_STEP_M = 0.08
_STEP_RAD = 0.1
_MOST_SCANS = 300
_FARTHEST_M = 8.0

# Largest distance of a return from its cylinder, step by step.
_FIRST_GATES_M = (0.10, 0.10, 0.07, 0.07, 0.05, 0.05)
_GATES_M = (0.06, 0.06, 0.05, 0.05, 0.04, 0.04, 0.04, 0.04)
# Least distance of a return from any other cylinder, and the least cosine of the angle
# at which a ray meets the surface: a grazing ray may hit an obstacle behind.
_OTHER_M = 0.03
_LEAST_SLANT = 0.35
_LEAST_RETURNS = 20
_LEAST_SHARE = 0.9

# Within these limits, positions are good to 3 mm. Beyond the second one, returns may
# be assigned to a neighbor.
_LARGEST_ERROR_MM = 1.0
_FARTHEST_MM = 50.0


@dataclass(frozen=True, eq=False)
class Survey:
    """The cylinders of a course as built, in the order of `World.planned_m`."""

    world: World  # as planned
    centers_m: Points
    errors_m: Floats  # standard error of each position relative to the others
    returns: Integers
    # What fixes the course as a whole: "plan", or poses in the world's frame.
    datum: str

    def table(self) -> pd.DataFrame:
        """Return a row per cylinder: place, offset, error, returns, why it is unsure."""
        x_m, y_m = self.world.planned_m.T
        dx_mm, dy_mm = 1000.0 * (self.centers_m - self.world.planned_m).T
        table = pd.DataFrame({"x_m": x_m, "y_m": y_m, "dx_mm": dx_mm, "dy_mm": dy_mm})
        table["off_mm"] = np.hypot(dx_mm, dy_mm)
        table["error_mm"] = 1000.0 * self.errors_m
        table["returns"] = self.returns
        # A few returns may be of a neighbor. The last reason that applies is kept.
        is_doubtful = table.error_mm > _LARGEST_ERROR_MM
        is_doubtful |= table.returns < _LEAST_RETURNS
        table["unsure"] = ""
        for reason, is_unsure in (
            ("seen too little", is_doubtful),
            ("too far off to identify", table.off_mm > _FARTHEST_MM),
            ("not seen", table.returns == 0),
        ):
            table.loc[is_unsure, "unsure"] = reason
        return table

    def built_world(self) -> World:
        """Return the world as built, with unsure cylinders placed as planned."""
        is_unsure = self.table()[["unsure"]].to_numpy() != ""
        built_m = np.where(is_unsure, self.world.planned_m, self.centers_m)
        return replace(self.world, built_m=built_m)


def survey_course(
    trial: RecordedTrial, world: World, start: Pose2D, tolerance_m: float
) -> Survey:
    """Locate a built course's cylinders from scans; BagError if scans do not fit.

    Args:
        trial: The drive, with odometry and scans.
        world: The plan.
        start: Pose of base_link in the map frame at the first pose of the drive; used
            unless poses are in the world's frame.
        tolerance_m: Expected standard deviation of misplacements [m].

    Raises:
        BagError: If the bag has no scans, or they do not fit the plan.
    """
    returns, places = _select_scans(trial)
    is_in_world_frame = trial.frame in FIXED_FRAMES
    if is_in_world_frame:
        start = trial.pose(0)

    # First fit each scan to the plan, so that errors of the odometry do not add up.
    plan_m = world.planned_m
    poses = np.empty((len(places), 3))
    pose = start @ trial.lidar
    last = trial.pose(0) @ trial.lidar
    recorded_m = np.empty((len(places), 2))
    for number, place in enumerate(places):
        lidar = trial.pose(place) @ trial.lidar
        recorded_m[number] = (lidar.x, lidar.y)
        pose = pose @ last.inverse() @ lidar
        last = lidar
        poses[number] = pose.numbers
        scan = returns[returns[:, 0] == number]
        for gate_m in _FIRST_GATES_M:
            matches, _ = _match(scan, poses, plan_m, world, gate_m)
            if len(matches) >= _LEAST_RETURNS:
                step, *_ = np.linalg.lstsq(matches[:, 3:6], matches[:, 2])
                poses[number] -= step
        pose = Pose2D(*poses[number].tolist())

    # Then adjust poses and cylinders together.
    first = poses.size
    centers_m = plan_m.copy()
    noise_m = 0.01
    for gate_m in _GATES_M:
        matches, share = _match(returns, poses, centers_m, world, gate_m)
        if share < _LEAST_SHARE:
            raise BagError(
                f"{trial.name}: its scans do not fit {world.name}: {share:.0%} of the"
                f" returns in it are near an obstacle, must be {_LEAST_SHARE:.0%}; name"
                " the world of the drive, --course if it began elsewhere, or other"
                " poses by --pose"
            )
        information, gradient = _normal_equations(matches, first, plan_m.size, noise_m)
        prior = tolerance_m**-2
        centers = range(first, len(gradient))
        information[centers, centers] += prior
        gradient[first:] += prior * (centers_m - plan_m).ravel()
        step = np.linalg.solve(information, gradient)
        poses -= step[:first].reshape(-1, 3)
        centers_m -= step[first:].reshape(-1, 2)
        # The median resists outliers; 1.4826 makes it a standard deviation.
        noise_m = 1.4826 * float(np.median(np.abs(matches[:, 2] / matches[:, 6])))

    datum = "plan"
    if is_in_world_frame:
        datum = f"poses in frame {trial.frame}"
        centers_m = _fit(poses[:, :2], recorded_m).transform(centers_m)
    counts = np.bincount(matches[:, 1].astype(int), minlength=len(plan_m))
    covariance = np.asarray(np.linalg.inv(information), np.float64)[first:, first:]
    errors_m = _standard_errors(covariance, centers_m, counts)
    survey = Survey(world, centers_m, errors_m, counts, datum)
    if (survey.table().unsure != "").all():
        raise BagError(
            f"{trial.name}: its scans locate no obstacle of {world.name}; poses must be"
            " in m, and the drive must be through the course"
        )
    return survey


def _select_scans(trial: RecordedTrial) -> tuple[Floats, list[int]]:
    """Return (returns (n, 3) of separated scans, index of each pose); BagError if none.

    A return is the number of its scan, its angle in the lidar's frame [rad] and its
    range [m]. Raises BagError if there are no scans.
    """
    last = Pose2D(np.inf, np.inf, 0.0)
    chosen: list[tuple[Scan, int]] = []
    for item in trial.items[topics.SCAN]:
        place = trial.index_at(item.time_s)
        pose = trial.pose(place)
        is_turned = chosen and abs((last.inverse() @ pose).yaw) > _STEP_RAD
        if is_turned or pose.distance(last) > _STEP_M:
            last = pose
            chosen.append((item.content, place))
    chosen = chosen[:: 1 + len(chosen) // _MOST_SCANS]
    if not chosen:
        raise BagError(f"{trial.name}: no scans on /scan to survey with")
    parts = []
    for number, (scan, _) in enumerate(chosen):
        angles = scan.angles()
        part = np.column_stack([np.full(len(angles), number), angles, scan.ranges])
        farthest_m = min(scan.range_max, _FARTHEST_M)
        parts.append(part[(part[:, 2] > scan.range_min) & (part[:, 2] < farthest_m)])
    return np.concatenate(parts), [place for _, place in chosen]


def _match(
    returns: Floats, poses: Floats, centers_m: Points, world: World, gate_m: float
) -> tuple[Floats, float]:
    """Return (returns that belong to one cylinder (n, 7), share near any cylinder).

    The columns are scan, cylinder, distance from the surface, normal x and y, how much a
    turn of the lidar moves the return off the surface, and the cosine of the angle
    between ray and normal. The share is of returns within the world, near means within
    the gate.
    """
    scans = returns[:, 0].astype(int)
    angles = poses[scans, 2] + returns[:, 1]
    rays = unit_vectors(angles)
    offsets_m = rays * returns[:, 2:]
    points_m = offsets_m + poses[scans, :2]
    distances_m, nearest = KDTree(centers_m).query(points_m, k=2)
    errors_m = distances_m - world.cylinder_radius_m
    normals = (points_m - centers_m[nearest[:, 0]]) / distances_m[:, :1]
    levers_m = offsets_m[:, 0] * normals[:, 1] - offsets_m[:, 1] * normals[:, 0]
    slants = -(normals * rays).sum(axis=1)

    errors = np.abs(errors_m[:, 0])
    is_clear = errors_m[:, 1] > np.maximum(_OTHER_M, 2.0 * errors)
    kept = (errors < gate_m) & is_clear & (slants > _LEAST_SLANT)
    low_x, low_y, high_x, high_y = world.bounds_m
    is_inside = (points_m > (low_x, low_y)) & (points_m < (high_x, high_y))
    inside = errors[is_inside.all(axis=1)]
    columns = [scans, nearest[:, 0], errors_m[:, 0], normals, levers_m, slants]
    share = float((inside < gate_m).sum()) / max(1, len(inside))
    return np.column_stack(columns)[kept], share


def _normal_equations(
    matches: Floats, pose_count: int, center_count: int, noise_m: float
) -> tuple[Floats, Floats]:
    """Return information (k, k) and gradient (k,) of all unknowns, first those of poses.

    Args:
        matches: What `_match` returns.
        pose_count: Number of unknowns of poses, three each.
        center_count: Number of unknowns of cylinders, two each.
        noise_m: Standard deviation of a range.
    """
    _, _, errors_m, x, y, levers_m, slants = matches.T
    scans, cylinders = matches[:, :2].astype(int).T
    pose = 3 * scans
    center = pose_count + 2 * cylinders
    columns = np.concatenate([pose, pose + 1, pose + 2, center, center + 1])
    values = np.concatenate([x, y, levers_m, -x, -y])
    rows = np.tile(np.arange(len(matches)), 5)
    shape = (len(matches), pose_count + center_count)
    jacobian = csr_matrix((values, (rows, columns)), shape=shape)
    # Noise is along the ray. Outliers count less (Cauchy's weights).
    deviations_m = noise_m * slants
    weights = deviations_m**-2 / (1.0 + (errors_m / (3.0 * deviations_m)) ** 2)
    weighted = jacobian.multiply(weights[:, None]).tocsr()
    information = (jacobian.T @ weighted).toarray()
    # A pose without matched returns stays where it is.
    information[range(pose_count), range(pose_count)] += 1e-3
    return information, weighted.T @ errors_m


def _fit(points_m: Points, targets_m: Points) -> Pose2D:
    """Return the rigid motion that best fits points (n, 2) to targets (n, 2)."""
    center_m = points_m.mean(axis=0)
    target_m = targets_m.mean(axis=0)
    x, y = (points_m - center_m).T
    target_x, target_y = (targets_m - target_m).T
    # Sums of dot and cross products are the cosine and the sine of the turn, scaled.
    cross = float(x @ target_y - y @ target_x)
    turn = Pose2D(0.0, 0.0, math.atan2(cross, float(x @ target_x + y @ target_y)))
    shift_x, shift_y = (target_m - turn.transform(center_m[None])[0]).tolist()
    return Pose2D(shift_x, shift_y, turn.yaw)


def _standard_errors(
    covariance: Floats, centers_m: Points, returns: Integers
) -> Floats:
    """Return each center's standard error (n,), worst axis; seen ones fix the frame."""
    # The datum fixes shift and turn of the whole course, so they are projected out.
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
    return np.sqrt(np.linalg.eigvalsh(blocks)[:, -1])
