"""A PyBullet client with the robot in it, stepped one tick at a time."""

import math
from functools import cache

import numpy as np

from barn_sim.body.free_motion import Triple
from barn_sim.body.model import RobotModel
from barn_sim.body.state import ROBOT, Fleet, set_body
from barn_sim.body.tires import Tires
from barn_sim.config import PhysicsConfig
from barn_sim.contact.bullet import PhysicsClient, add_body, bullet
from barn_sim.motion.ticks import LEVEL, STILL, State, follow, place_at_rest, way_back
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Pose2D

# Bodies created in the same order in an empty client and stepped alike move alike, to the last bit.
# Ticks after which the broad phase balances the same branches of its tree again, as far as it has levels among fixed
# obstacles: only those that have just become bodies are in it, so six levels are plenty.
_CYCLE = 64
_ENGINE = {
    "numSubSteps": 0,
    "numSolverIterations": 20,
    "deterministicOverlappingPairs": 1,
}
_tires_of = cache(Tires)


class Body:
    """The robot as one rigid body on its tyres, alone in a physics client.

    PyBullet has the body from the first tick on that it is to move. client: PyBullet's number of the client, -1 before;
    id: the robot's body in it; ground: the body that obstacles stand on (the robot touches it only through its tyres).
    fleet, index: whose state it keeps.
    """

    def __init__(
        self,
        model: RobotModel,
        config: PhysicsConfig,
        client: PhysicsClient,
        fleet: Fleet,
        index: int,
    ) -> None:
        self._model, self._config, self._physics = model, config, client
        self._fleet, self._index, settings = fleet, index, fleet.settings
        self._tires = tires = _tires_of(model, config)
        self._begun_at: Pose2D | None = None
        if not settings["tick_ns"]:
            set_body(settings, model, config, tires.stiffness, tires.damping)
            settings["first_inverse_inertia"] = first_inverse_inertia_of(model)

    def begin(self, start: Pose2D, *, stays: bool = False) -> None:
        """Put the robot on the ground, at rest, with nothing else in its state.

        stays: whether ground and robot stay in the engine for the next robot, which they can where obstacles are fixed.
        """
        self.client = self.id = self.ground = -1
        self._stays, robots, index = stays, self._fleet.robots, self._index
        if start != self._begun_at:
            self._begun_at, self._at_rest = start, np.zeros(1, ROBOT)
            height, roll, pitch = self._tires.rest
            attitude = bullet.getQuaternionFromEuler([roll, pitch, start.yaw])
            offset = (
                np.array(bullet.getMatrixFromQuaternion(attitude)).reshape(3, 3)
                @ self._model.center_of_mass
            )
            self._start = (
                [start.x + offset[0], start.y + offset[1], height],
                attitude,
            )  # of the centre of mass
            robot = self._at_rest[0]
            robot["wheels"][: len(self._tires.wheels), :5], robot["known"] = (
                self._tires.wheels,
                True,
            )
            robot["position"], robot["heading"] = self._start
            place_at_rest(self._at_rest, self._fleet.settings, 0)
        robots[index] = self._at_rest[0]

    def enter(self) -> None:
        """Let PyBullet have the body, at the robot's start unless it goes on in place of the last one."""
        robot, kind = self._fleet.robots[self._index], (self._model, self._config)
        found = self._physics.resume(kind) if self._stays and robot["away"] else None
        self.client = client = self._physics.id
        if found is not None:
            self.ground, self.id = found
            return
        config = self._config
        bullet.setGravity(0.0, 0.0, -config.gravity_m_s2, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=config.tick_s, physicsClientId=client, **_ENGINE
        )
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        self.ground = bullet.createMultiBody(
            0.0, plane, useMaximalCoordinates=True, physicsClientId=client
        )
        bullet.changeDynamics(
            self.ground, -1, lateralFriction=1.0, physicsClientId=client
        )
        friction, inertia = config.chassis_friction, self._model.inertia.tolist()
        dynamics = {
            "lateralFriction": friction,
            "angularDamping": 0.0,
            "localInertiaDiagonal": inertia,
        }
        self.id = add_body(
            client,
            _make_shapes(self._model, client),
            *self._start,
            self._model.mass_kg,
            **dynamics,
        )
        bullet.setCollisionFilterPair(
            self.ground, self.id, -1, -1, 0, physicsClientId=client
        )
        self._physics.engine.residents = (
            kind if self._stays else None,
            self.ground,
            self.id,
        )

    def leave(self) -> None:
        """Leave the engine to others until PyBullet has to move the body again."""
        if self.id >= 0:
            self._physics.empty()
            self.id = -1

    def move(self, centre: Triple, force: Triple, torque: Triple) -> Triple:
        """Advance a tick in Bullet under a force (N) at the centre of mass and a torque (N m); return x, y, yaw."""
        # positional arguments, which PyBullet parses faster
        bullet.applyExternalForce(
            self.id, -1, force, centre, bullet.WORLD_FRAME, self.client
        )
        bullet.applyExternalTorque(self.id, -1, torque, bullet.WORLD_FRAME, self.client)
        self._physics.tick()
        placed = bullet.getBasePositionAndOrientation(self.id, self.client)
        moved = *placed, *bullet.getBaseVelocity(self.id, self.client)
        fleet, index = self._fleet, self._index
        now: Triple = follow(fleet.robots, fleet.settings, index, moved, fleet.noise)
        return now

    def come_back(self) -> None:
        """Bring the body in Bullet to where the robot has gone without it; no guest may be in the client.

        PyBullet sets positions and velocities, but not the inertia in the world frame, which Bullet computes in a tick.
        So the body goes through the last tick once more, from where its inertia is known. How many ticks there were
        matters by their last digits in binary: the broad phase balances its tree by them, and its order decides in
        which order contacts are solved.
        """
        robots, settings, index = self._fleet.robots, self._fleet.settings, self._index
        ticks = int(robots["stamp_ns"][index] // settings["tick_ns"][0])
        missing = ticks - 1 - self._physics.engine.ticks  # before the last
        if self._stays or ticks == 1:
            missing = (missing - 1) % _CYCLE + 1
        start, torque, end = way_back(robots, settings, index, missing > 0)
        if missing:
            self._set((STILL, LEVEL, STILL, STILL))
        self._physics.tick(missing)
        self._set(start)
        bullet.applyExternalTorque(self.id, -1, torque, bullet.WORLD_FRAME, self.client)
        self._physics.tick()
        self._set(end)

    def _set(self, placed: State) -> None:
        position, heading, velocity, spin = placed
        bullet.resetBasePositionAndOrientation(self.id, position, heading, self.client)
        bullet.resetBaseVelocity(self.id, velocity, spin, self.client)


@cache
def first_inverse_inertia_of(model: RobotModel) -> Floats:
    """Return the inverse inertia (3,) with which Bullet begins: of the shapes, as if they were filled evenly."""
    client = PhysicsClient()
    shapes = _make_shapes(model, client.id)
    body = bullet.createMultiBody(
        model.mass_kg, shapes, useMaximalCoordinates=True, physicsClientId=client.id
    )
    inertia = np.array(bullet.getDynamicsInfo(body, -1, physicsClientId=client.id)[2])
    client.close()
    return 1.0 / inertia


def _make_shapes(model: RobotModel, client: int) -> int:
    shapes, places = (
        model.shapes,
        [(shape.center - model.center_of_mass).tolist() for shape in model.shapes],
    )
    made: int
    if shapes[0].corners is not None:
        half = float(shapes[0].half_sizes[2])
        corners = [
            [x, y, z] for x, y in shapes[0].corners.tolist() for z in (-half, half)
        ]
        made = bullet.createCollisionShape(
            bullet.GEOM_MESH,
            vertices=corners,
            collisionFramePosition=places[0],
            physicsClientId=client,
        )
        return made
    along_y = bullet.getQuaternionFromEuler([0.5 * math.pi, 0.0, 0.0])
    made = bullet.createCollisionShapeArray(
        shapeTypes=[
            bullet.GEOM_CYLINDER if shape.radius_m else bullet.GEOM_BOX
            for shape in shapes
        ],
        halfExtents=[shape.half_sizes.tolist() for shape in shapes],
        radii=[shape.radius_m for shape in shapes],
        lengths=[2.0 * float(shape.half_sizes[1 + shape.upright]) for shape in shapes],
        collisionFramePositions=places,
        collisionFrameOrientations=[
            [0.0, 0.0, 0.0, 1.0] if shape.upright else along_y for shape in shapes
        ],
        physicsClientId=client,
    )
    return made
