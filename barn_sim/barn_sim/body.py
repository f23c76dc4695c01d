"""A PyBullet client with the robot in it, stepped one tick at a time."""

import math

import numpy as np

from barn_sim.bullet import PhysicsClient, add_body, bullet
from barn_sim.config import PhysicsConfig
from barn_sim.model import RobotModel
from barn_sim.tyres import Quaternion, Triple, Tyres, offset_of_centre, place
from barn_worlds.types import Pose2D, Velocity2D

# Bodies created in the same order in an empty client and stepped alike move alike, to the last bit.
_ENGINE = {"numSubSteps": 0, "numSolverIterations": 20, "deterministicOverlappingPairs": 1}


class Body:
    """The robot as one rigid body on its tyres, alone in a physics client.

    client: PyBullet's number of the client; id: the robot's body in it; ground: the body that obstacles stand on (the
    robot touches it only through its tyres).
    """

    def __init__(self, model: RobotModel, config: PhysicsConfig, start: Pose2D, client: PhysicsClient) -> None:
        self.client = client.id
        self._model = model
        self._tyres = Tyres(model, config)
        self._centre = model.centre_of_mass
        self._state: tuple[Triple, Quaternion, Triple, Triple]
        self._pose: Pose2D | None = None  # of that state, once asked for
        bullet.setGravity(0.0, 0.0, -config.gravity_m_s2, physicsClientId=self.client)
        bullet.setPhysicsEngineParameter(fixedTimeStep=config.tick_s, physicsClientId=self.client, **_ENGINE)
        self.ground = self._make_ground()
        self.id = self._make_robot(config, start)
        bullet.setCollisionFilterPair(self.ground, self.id, -1, -1, 0, physicsClientId=self.client)
        self._read()

    def _make_ground(self) -> int:
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=self.client)
        ground: int = bullet.createMultiBody(0.0, plane, useMaximalCoordinates=True, physicsClientId=self.client)
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=self.client)
        return ground

    def _make_robot(self, config: PhysicsConfig, start: Pose2D) -> int:
        height, roll, pitch = self._tyres.rest()
        attitude = bullet.getQuaternionFromEuler([roll, pitch, start.yaw])
        offset = np.array(bullet.getMatrixFromQuaternion(attitude)).reshape(3, 3) @ self._centre
        position = [start.x + offset[0], start.y + offset[1], height]
        inertia = self._model.inertia.tolist()
        dynamics = {"lateralFriction": config.chassis_friction, "angularDamping": 0.0, "localInertiaDiagonal": inertia}
        return add_body(self.client, self._make_shapes(), position, attitude, self._model.mass_kg, **dynamics)

    def _make_shapes(self) -> int:
        kinds, half_sizes, radii, lengths, attitudes = [], [], [], [], []
        along_y = bullet.getQuaternionFromEuler([0.5 * math.pi, 0.0, 0.0])
        for shape in self._model.shapes:
            box = shape.half_sizes is not None
            kinds.append(bullet.GEOM_BOX if box else bullet.GEOM_CYLINDER)
            half_sizes.append(shape.half_sizes.tolist() if shape.half_sizes is not None else [0.0, 0.0, 0.0])
            radii.append(shape.radius_m)
            lengths.append(shape.length_m)
            attitudes.append([0.0, 0.0, 0.0, 1.0] if box else along_y)
        compound: int = bullet.createCollisionShapeArray(
            shapeTypes=kinds,
            halfExtents=half_sizes,
            radii=radii,
            lengths=lengths,
            collisionFramePositions=[(shape.centre - self._centre).tolist() for shape in self._model.shapes],
            collisionFrameOrientations=attitudes,
            physicsClientId=self.client,
        )
        return compound

    def step(self, left_m_s: float, right_m_s: float) -> None:
        """Advance one tick with the wheel rims at these speeds."""
        self.push(left_m_s, right_m_s)
        self.move()

    def push(self, left_m_s: float, right_m_s: float) -> Triple:
        """Apply the forces of the ground for a tick with these rim speeds; return x, y, yaw of base_link now."""
        force, torque, now = self._tyres.act(*self._state, left_m_s, right_m_s)
        bullet.applyExternalForce(self.id, -1, force, self._state[0], bullet.WORLD_FRAME, self.client)
        bullet.applyExternalTorque(self.id, -1, torque, bullet.WORLD_FRAME, self.client)
        return now

    def move(self) -> None:
        """Advance one tick under the forces applied."""
        bullet.stepSimulation(self.client)
        self._read()

    def _read(self) -> None:
        # positional arguments, which PyBullet parses faster
        position, attitude = bullet.getBasePositionAndOrientation(self.id, self.client)
        velocity, spin = bullet.getBaseVelocity(self.id, self.client)
        self._state = position, attitude, velocity, spin
        self._pose = None

    @property
    def pose(self) -> Pose2D:
        """Pose of base_link now."""
        if self._pose is None:
            self._pose = Pose2D(*place(self._state[0], self._state[1], self._centre))
        return self._pose

    def velocity(self) -> Velocity2D:
        """Return forward speed of base_link and yaw rate."""
        _, attitude, velocity, spin = self._state
        x, y, z = offset_of_centre(self._centre, attitude)
        vx = velocity[0] - (spin[1] * z - spin[2] * y)
        vy = velocity[1] - (spin[2] * x - spin[0] * z)
        yaw = self.pose.yaw
        return Velocity2D(vx * math.cos(yaw) + vy * math.sin(yaw), spin[2])
