"""A physics client with the robot in it, which computes contacts with obstacles.

Equal contacts must have equal results, to the last bit, whatever the client did before.
Bullet solves contacts in an order that follows from how its bodies were created. So a
scene always begins a contact alike: with the ground and the robot, which stay in it,
and no contact points. Obstacles are created in a fixed order and at the end of the
contact removed in reverse order, which leaves Bullet's lists as they were; if some were
removed before, everything is created anew. The simple broad phase has no memory beyond
these lists; the default one balances its trees by the number of ticks since it was
created.
"""

import math
from collections.abc import Sequence

from barn_sim.body.model import RobotModel, Shape
from barn_sim.body.vectors import BodyState, Vector
from barn_sim.config import PhysicsConfig
from barn_sim.contact.bullet import bullet, connect, disconnect

STILL = (0.0, 0.0, 0.0)
_SOLVER_ITERATIONS = 20


class ContactScene:
    """Level ground, a robot that does not collide with it, and obstacles."""

    client: int
    """PyBullet's number of the physics client."""

    robot: int
    """PyBullet's number of the robot's body."""

    def __init__(self, model: RobotModel, config: PhysicsConfig):
        """Start a client with the ground and a robot that does not collide with it.

        Args:
            model: Shapes and inertia of the robot. It stands on its tires, which
                `barn_sim.body.rigid_body` computes.
            config: Tick, gravity and friction.
        """
        self.model = model
        self.config = config
        self.client = connect()
        self._reset()

    def _reset(self) -> None:
        """Empty the client, and create the ground and the robot anew."""
        self._obstacles: list[int] = []
        self._is_in_order = True
        self._shapes: dict[tuple[float, ...], int] = {}

        client = self.client
        model = self.model
        config = self.config
        flags = bullet.RESET_USE_SIMPLE_BROADPHASE
        bullet.resetSimulation(flags=flags, physicsClientId=client)
        bullet.setGravity(0.0, 0.0, -config.gravity_m_s2, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=config.tick_s,
            numSubSteps=0,
            numSolverIterations=_SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )

        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        upright = (0.0, 0.0, 0.0, 1.0)
        ground = self._create(plane, STILL, upright, 0.0, lateralFriction=1.0)
        self.robot = self._create(
            _robot_shape(model, client),
            STILL,
            upright,
            model.mass_kg,
            lateralFriction=config.chassis_friction,
            angularDamping=0.0,
            localInertiaDiagonal=model.inertia.tolist(),
        )
        # The robot stands on its tires, which are computed elsewhere.
        bullet.setCollisionFilterPair(
            ground, self.robot, -1, -1, 0, physicsClientId=client
        )

    @property
    def is_connected(self) -> bool:
        """Whether the client still runs: anybody in the process may end it."""
        return bool(bullet.isConnected(self.client))

    def place_robot(self, state: BodyState) -> None:
        """Set the robot's state by simulating a tick; no obstacle may be there."""
        position, attitude, _, _ = state
        # PyBullet sets the pose, but not the inertia in the world frame, which Bullet
        # computes at the end of a tick. So a tick passes at that pose before.
        self.set_state(self.robot, (position, attitude, STILL, STILL))
        bullet.stepSimulation(self.client)
        self.set_state(self.robot, state)

    def set_state(self, body: int, state: BodyState) -> None:
        """Set pose, velocity and spin of a body at once, without simulating.

        Args:
            body: PyBullet's number of the body.
            state: Its pose and velocities from now on.
        """
        position, attitude, velocity, spin = state
        bullet.resetBasePositionAndOrientation(body, position, attitude, self.client)
        bullet.resetBaseVelocity(body, velocity, spin, self.client)

    def tick(self, position: Vector, force: Vector, torque: Vector) -> BodyState:
        """Apply force and torque to the robot, simulate one tick, return its new state.

        Args:
            position: Of the robot's center of mass, at which the force acts, m.
            force: On the robot, without gravity, N.
            torque: About its center of mass, N m.

        Returns:
            State of the robot.
        """
        # Positional arguments, which PyBullet parses faster.
        robot = self.robot
        client = self.client
        world = bullet.WORLD_FRAME
        bullet.applyExternalForce(robot, -1, force, position, world, client)
        bullet.applyExternalTorque(robot, -1, torque, world, client)
        bullet.stepSimulation(client)
        return self.state(robot)

    def state(self, body: int) -> BodyState:
        """Return position, quaternion, velocity and spin of a body (world frame)."""
        position, attitude = bullet.getBasePositionAndOrientation(body, self.client)
        velocity, spin = bullet.getBaseVelocity(body, self.client)
        return position, attitude, velocity, spin

    def is_robot_touched(self) -> bool:
        """Tell whether the robot touched anything but the ground in the last tick."""
        contacts = bullet.getContactPoints(
            bodyA=self.robot, physicsClientId=self.client
        )
        for contact in contacts:
            # Bullet also lists points at small gaps, which are no contact unless they
            # carry a force.
            distance = contact[8]
            normal_force = contact[9]
            if distance <= 0.0 or normal_force > 0.0:
                return True
        return False

    def add(
        self,
        size: tuple[float, ...],
        position: Sequence[float],
        attitude: Sequence[float],
        mass_kg: float,
        group: int,
        mask: int,
        **dynamics: object,
    ) -> int:
        """Add a cylinder (2 sizes) or box (3 half sizes); return PyBullet's number.

        Args:
            size: Radius and length of a cylinder along z, or half sizes of a box, m.
            position: Center (3,), m.
            attitude: Quaternion (4,).
            mass_kg: Mass; 0 for a fixed body.
            group: Bullet's filter group of a body that is not fixed.
            mask: Groups that a body that is not fixed may touch; -1: all.
            **dynamics: Arguments of PyBullet's changeDynamics, such as lateralFriction.

        Returns:
            PyBullet's number of the body.
        """
        if size not in self._shapes:
            kind = bullet.GEOM_CYLINDER
            half_sizes: tuple[float, ...] = (0.0, 0.0, 0.0)
            if len(size) == 3:
                kind = bullet.GEOM_BOX
                half_sizes = size
            # Each kind of shape ignores the arguments of the other.
            self._shapes[size] = bullet.createCollisionShape(
                kind,
                radius=size[0],
                height=size[1],
                halfExtents=half_sizes,
                physicsClientId=self.client,
            )
        body = self._create(self._shapes[size], position, attitude, mass_kg, **dynamics)
        if mass_kg:
            bullet.setCollisionFilterGroupMask(
                body, -1, group, mask, physicsClientId=self.client
            )
        self._obstacles.append(body)
        return body

    def _create(
        self,
        shape: int,
        position: Sequence[float],
        attitude: Sequence[float],
        mass_kg: float,
        **dynamics: object,
    ) -> int:
        """Create a rigid body of a collision shape; return PyBullet's number of it."""
        body: int = bullet.createMultiBody(
            mass_kg,
            shape,
            -1,
            position,
            attitude,
            # Plain rigid bodies and not articulated ones: nothing here has joints.
            useMaximalCoordinates=True,
            physicsClientId=self.client,
        )
        bullet.changeDynamics(
            body,
            -1,
            mass=mass_kg,
            linearDamping=0.0,
            physicsClientId=self.client,
            **dynamics,
        )
        return body

    def remove(self, body: int) -> None:
        """Remove one obstacle's body, after which `clear` creates everything anew."""
        bullet.removeBody(body, physicsClientId=self.client)
        self._obstacles.remove(body)
        self._is_in_order = False

    def clear(self) -> None:
        """Remove all obstacles, so that the next contact begins as in a new scene."""
        if not self._is_in_order:
            self._reset()
            return
        for body in reversed(self._obstacles):
            bullet.removeBody(body, physicsClientId=self.client)
        self._obstacles.clear()

    def close(self) -> None:
        """End the physics client."""
        disconnect(self.client)


class ScenePool:
    """Scenes for the robots of a process, each used by one robot at a time.

    A scene takes milliseconds to create and is needed only while an obstacle is near.
    """

    def __init__(self) -> None:
        """Create an empty pool; `acquire` adds scenes."""
        self._idle: list[ContactScene] = []

    def acquire(self, model: RobotModel, config: PhysicsConfig) -> ContactScene:
        """Return a fitting idle scene, else close the oldest idle one and create one.

        Args:
            model: The robot in it.
            config: Tick, gravity and friction.
        """
        for scene in reversed(self._idle):
            # `model_of` is cached, so equal robots share one model.
            if scene.model is model and scene.config == config:
                self._idle.remove(scene)
                if scene.is_connected:
                    return scene
        # Robots of another kind are gone or busy. Their scenes take tens of megabytes.
        if self._idle:
            self._idle.pop(0).close()
        return ContactScene(model, config)

    def release(self, scene: ContactScene) -> None:
        """Clear a scene and keep it for reuse, or drop it if its client has ended."""
        if scene.is_connected:
            scene.clear()
            self._idle.append(scene)

    def close(self) -> None:
        """End the idle scenes; those that robots use stay open."""
        while self._idle:
            self._idle.pop().close()


def _robot_shape(model: RobotModel, client: int) -> int:
    """Create a robot's collision shape about its center of mass; return its number."""
    shapes = model.shapes
    positions = [(shape.center - model.center_of_mass).tolist() for shape in shapes]
    if shapes[0].corners is not None:
        prism: int = bullet.createCollisionShape(
            bullet.GEOM_MESH,
            vertices=_prism_vertices(shapes[0]),
            collisionFramePosition=positions[0],
            physicsClientId=client,
        )
        return prism

    along_z = (0.0, 0.0, 0.0, 1.0)
    along_y = bullet.getQuaternionFromEuler([0.5 * math.pi, 0.0, 0.0])
    kinds = []
    lengths = []
    attitudes = []
    for shape in shapes:
        kind = bullet.GEOM_BOX
        if shape.radius_m:
            kind = bullet.GEOM_CYLINDER
        # Bullet's cylinders are along z, so the wheels are turned about x.
        length_axis = 1
        attitude = along_y
        if shape.upright:
            length_axis = 2
            attitude = along_z
        kinds.append(kind)
        lengths.append(2.0 * float(shape.half_sizes[length_axis]))
        attitudes.append(attitude)
    compound: int = bullet.createCollisionShapeArray(
        shapeTypes=kinds,
        halfExtents=[shape.half_sizes.tolist() for shape in shapes],
        radii=[shape.radius_m for shape in shapes],
        lengths=lengths,
        collisionFramePositions=positions,
        collisionFrameOrientations=attitudes,
        physicsClientId=client,
    )
    return compound


def _prism_vertices(shape: Shape) -> list[list[float]]:
    """Return the corners (2 k, 3) of a prism about its center, m."""
    assert shape.corners is not None
    half = float(shape.half_sizes[2])
    vertices = []
    for x, y in shape.corners.tolist():
        vertices += [[x, y, -half], [x, y, half]]
    return vertices
