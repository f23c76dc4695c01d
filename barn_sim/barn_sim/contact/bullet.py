"""PyBullet: imported without the line that it prints on standard error, its engines and bodies."""

import importlib
import os
import sys
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any


def _silenced_import() -> Any:
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # standard error is closed
        return importlib.import_module("pybullet")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


bullet = _silenced_import()

_RENDERER = 2  # PyBullet's own number of the plug-in that draws
_MOVING, _STANDING = (
    (1, -1),
    (2, ~2),
)  # PyBullet's groups and masks of bodies that move and of those that do not
_FAR_AWAY, _UPRIGHT = (0.0, 0.0, -1000.0), (0.0, 0.0, 0.0, 1.0)


@dataclass(eq=False)
class PhysicsEngine:
    """An engine of PyBullet, its number there, and what is in it.

    ticks: simulated since it was new or reset; residents: kind, ground and robot that stay in it and can go on there
    for the next robot of their kind. Guests are bodies that come and go; guests: kinds of those that are there, None of
    those that move; kept: those of a kind that stand far away until needed again. shapes: of cylinders, by size.
    """

    id: int
    ticks: int = 0
    residents: tuple[object, int, int] | None = None
    guests: dict[int, Hashable] = field(default_factory=dict)
    kept: dict[Hashable, list[int]] = field(default_factory=dict)
    shapes: dict[tuple[float, float], int] = field(default_factory=dict)

    @property
    def running(self) -> bool:
        """Whether nobody else in the process has ended it."""
        return bool(bullet.isConnected(self.id))


class PhysicsClient:
    """Has a physics engine from when it is first used until it is emptied. Every one behaves exactly like a new one.

    draws: whether pictures can be taken. Without, a body is ready in a tenth of the time: no mesh is made of it.
    idle: engines to be used, where those that it no longer uses are left, for clients that share them; its own without.
    """

    def __init__(
        self, *, draws: bool = False, idle: list[PhysicsEngine] | None = None
    ) -> None:
        self._draws, self._shares = draws, idle is not None
        self._idle: list[PhysicsEngine] = [] if idle is None else idle
        self._engine: PhysicsEngine | None = None

    @property
    def id(self) -> int:
        """PyBullet's number of the engine, which is ready then."""
        return self.engine.id

    @property
    def engine(self) -> PhysicsEngine:
        """The engine, an empty one if it had none."""
        if self._engine is None:
            self._engine = self._begin()
        return self._engine

    def _begin(self) -> PhysicsEngine:
        while self._idle:
            last = self._idle.pop()
            if last.running:
                bullet.resetSimulation(physicsClientId=last.id)
                return PhysicsEngine(last.id)
        number = bullet.connect(bullet.DIRECT)
        if number < 0:
            raise RuntimeError("PyBullet has no room for another physics client")
        if not self._draws:
            bullet.unloadPlugin(_RENDERER, physicsClientId=number)
        return PhysicsEngine(number)

    def tick(self, count: int = 1) -> None:
        """Simulate so many ticks."""
        engine = self.engine
        for _ in range(count):
            bullet.stepSimulation(engine.id)
        engine.ticks += count

    def resume(self, kind: object) -> tuple[int, int] | None:
        """Return ground and robot, if they are of this kind in the engine that is to be used next; it then is."""
        last = self._idle[-1] if self._engine is None and self._idle else None
        if (
            last is None
            or last.residents is None
            or last.residents[0] != kind
            or not last.running
        ):
            return None
        self._engine = self._idle.pop()
        for body in list(last.guests):
            self.send_away(body)
        return last.residents[1:]

    def receive(self, make: Callable[[], int]) -> int:
        """Have a guest made, and return its body.

        Before the first, Bullet's broad phase is told of the robot as if it were new. In which order contacts are
        solved then does not depend on where the robot has been.
        """
        engine = self.engine
        if engine.residents is not None and not engine.guests:
            self._renew(engine.residents[2], _MOVING)
        body = make()
        engine.guests[body] = None
        return body

    def receive_standing(
        self, kind: Hashable, position: Sequence[float], make: Callable[[], int]
    ) -> int:
        """Have a guest that stands upright; kind: what decides how it is made. Bodies of a kind are used again."""
        engine, again = self.engine, bool(self.engine.kept.get(kind))
        body = self.receive(engine.kept[kind].pop if again else make)
        engine.guests[body] = kind
        if again:
            bullet.resetBasePositionAndOrientation(
                body, position, _UPRIGHT, physicsClientId=engine.id
            )
            self._renew(body, _STANDING)
        return body

    def send_away(self, body: int) -> None:
        """Let a guest go."""
        engine = self.engine
        kind = engine.guests.pop(body)
        if kind is None:
            bullet.removeBody(body, physicsClientId=engine.id)
            return
        bullet.resetBasePositionAndOrientation(
            body, _FAR_AWAY, _UPRIGHT, physicsClientId=engine.id
        )
        self._renew(body, _STANDING)
        engine.kept.setdefault(kind, []).append(body)

    def _renew(self, body: int, filters: tuple[int, int]) -> None:
        """Let the broad phase forget a body and find it anew."""
        bullet.setCollisionFilterGroupMask(body, -1, *filters, physicsClientId=self.id)

    def empty(self) -> None:
        """Leave the engine; the next one is empty, its bodies numbered from 0."""
        if self._engine is not None:
            self._idle.append(self._engine)
            self._engine = None

    def close(self) -> None:
        """Release the engine; closing again does nothing."""
        self.empty()
        if not self._shares:
            end(self._idle)


def end(engines: list[PhysicsEngine]) -> None:
    """End those engines of a list that run, and empty it."""
    while engines:
        if (last := engines.pop()).running:
            bullet.disconnect(physicsClientId=last.id)


def add_body(
    client: int,
    shape: int,
    position: Sequence[float],
    attitude: Sequence[float],
    mass_kg: float,
    **dynamics: object,
) -> int:
    """Add one rigid body of a collision shape, its centre at `position` (3,), m, and return its number.

    attitude: quaternion x, y, z, w. mass_kg: 0 for a fixed body. dynamics: further arguments of PyBullet's
    changeDynamics, such as lateralFriction.
    """
    body: int = bullet.createMultiBody(
        mass_kg,
        shape,
        -1,
        position,
        attitude,
        useMaximalCoordinates=True,
        physicsClientId=client,
    )
    bullet.changeDynamics(
        body, -1, mass=mass_kg, linearDamping=0.0, physicsClientId=client, **dynamics
    )
    # so that Bullet uses the inertia just set from the first tick on
    bullet.resetBasePositionAndOrientation(
        body, position, attitude, physicsClientId=client
    )
    return body
