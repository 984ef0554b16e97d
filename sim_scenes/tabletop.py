"""Objects dropped on a table and settled by physics (pybullet). World: z up, table top at z = 0."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mapping.errors import ContraMapError
from mapping.folders import scratch_folder
from sim_scenes.convex_parts import collision_file, write_parts
from sim_scenes.objects.object_model import ObjectModel


@dataclass(frozen=True)
class TabletopConfig:
    """How a scene is composed and settled."""

    objects: tuple[int, int] = (3, 10)
    """Fewest and most objects dropped."""
    drop_radius_m: float = 0.22
    """Objects are dropped within this distance of the table's centre."""
    table_size_m: tuple[float, float] = (1.6, 1.2)
    """Extent of the table top along x and y."""
    upright: float = 0.5
    """Share of objects dropped as they stand in their own frame, turned about z only."""
    density: float = 500.0
    """Mass per volume [kg/m^3]."""
    step_s: float = 1 / 240
    """Physics time step."""
    between_drops_s: float = 0.35
    """Time given to an object before the next one falls."""
    settle_s: float = 5.0
    """Longest time waited for everything to come to rest."""
    still_speed: float = 0.004
    """Speed [m/s], and a tenth of the turning speed [rad/s], below which an object is at rest."""
    margin_m: float = 0.0002
    """Gap that physics keeps between objects."""
    rest_radius_m: float = 0.45
    """Objects that rolled farther from the centre are taken away."""


@dataclass(frozen=True)
class PlacedObject:
    """An object at rest. T_world_object: (4, 4) rigid pose [m]."""

    model: ObjectModel
    T_world_object: np.ndarray


class Tabletop:
    """A physics world with a table; use as a context manager.

    Objects fall one after another; those that leave the table or keep moving are taken away.
    """

    def __init__(self, config: TabletopConfig | None = None) -> None:
        self.config = config or TabletopConfig()
        with quiet_stdout():
            import pybullet
        self._bullet = pybullet
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise ContraMapError("pybullet could not start a physics world (too many open ones?)")
        self._scratch = ExitStack()
        self._folder = self._scratch.enter_context(scratch_folder("tabletop"))
        self._bodies: dict[int, ObjectModel] = {}
        bullet, client = self._bullet, self._client
        bullet.setGravity(0, 0, -9.81, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self.config.step_s,
            numSolverIterations=80,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        half = [self.config.table_size_m[0] / 2, self.config.table_size_m[1] / 2, 0.05]
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
        table = bullet.createMultiBody(0, shape, basePosition=[0, 0, -0.05], physicsClientId=client)
        bullet.changeDynamics(table, -1, lateralFriction=0.8, physicsClientId=client)

    def __enter__(self) -> Tabletop:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bullet.disconnect(self._client)
        self._scratch.close()

    def drop(self, models: Sequence[ObjectModel], rng: np.random.Generator) -> None:
        """Let the models fall one after another at random places and in random orientations, then settle."""
        for model in models:
            if rng.random() < self.config.upright:
                rotation = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
            else:
                rotation = Rotation.random(random_state=rng)
            radius = self.config.drop_radius_m * np.sqrt(rng.random())
            angle = rng.uniform(0, 2 * np.pi)
            x, y = radius * np.array([np.cos(angle), np.sin(angle)])
            bottom = -rotation.apply(model.mesh.vertices - model.center_of_mass)[:, 2].min()
            self._add(model, rotation, np.array([x, y, self._top() + bottom + 0.01]))
            self._step(self.config.between_drops_s)
        self.settle()

    def place(self, item: PlacedObject) -> None:
        """Put an object at a pose, at rest; it moves when time passes."""
        T = item.T_world_object
        position = T[:3, :3] @ item.model.center_of_mass + T[:3, 3]
        self._add(item.model, Rotation.from_matrix(T[:3, :3]), position)

    @property
    def physics(self) -> tuple[Any, int]:
        """pybullet and this world's client number, for whoever brings something of his own into it."""
        return self._bullet, self._client

    @property
    def bodies(self) -> list[int]:
        """pybullet's number of each object, in the order of placed()."""
        return list(self._bodies)

    def settle(self) -> None:
        """Run until all objects are at rest, taking away those that leave the table or never stop."""
        while True:
            moving = self._wait_until_still()
            lost = [body for body in self._bodies if self._left_table(body)] or moving
            if not lost:
                return
            for body in lost:
                self._take(body)

    def remove(self, indices: Sequence[int]) -> None:
        """Take away the objects at these positions of `placed()`, and settle what leaned on them."""
        for body in [list(self._bodies)[index] for index in indices]:
            self._take(body)
        self.settle()

    def placed(self) -> list[PlacedObject]:
        """The objects on the table with their poses."""
        found = []
        for body, model in self._bodies.items():
            position, quaternion = self._bullet.getBasePositionAndOrientation(
                body, physicsClientId=self._client
            )
            T = np.eye(4)
            T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
            T[:3, 3] = np.asarray(position) - T[:3, :3] @ model.center_of_mass
            found.append(PlacedObject(model, T))
        return found

    def _add(self, model: ObjectModel, rotation: Rotation, position: np.ndarray) -> None:
        bullet, client = self._bullet, self._client
        shape = bullet.createCollisionShape(
            bullet.GEOM_MESH, fileName=str(self._collision_file(model)), physicsClientId=client
        )
        solid = model.mesh.volume if model.watertight else 0.5 * model.mesh.convex_hull.volume
        body = bullet.createMultiBody(
            max(self.config.density * abs(float(solid)), 0.02),
            shape,
            basePosition=position.tolist(),
            baseOrientation=rotation.as_quat(),
            physicsClientId=client,
        )
        bullet.changeDynamics(
            body,
            -1,
            lateralFriction=0.8,
            rollingFriction=0.002,
            spinningFriction=0.002,
            linearDamping=0.1,
            angularDamping=0.2,
            restitution=0.0,
            collisionMargin=self.config.margin_m,
            physicsClientId=client,
        )
        self._bodies[body] = model

    def _collision_file(self, model: ObjectModel) -> Path:
        if not model.parts:
            return collision_file(model)
        path = self._folder / f"{len(self._bodies)}.obj"
        write_parts(model, model.parts, path)
        return path

    def _top(self) -> float:
        """Height [m] of the highest object."""
        boxes = [self._bullet.getAABB(body, physicsClientId=self._client) for body in self._bodies]
        return max((high[2] for _, high in boxes), default=0.0)

    def _step(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / self.config.step_s))):
            self._bullet.stepSimulation(physicsClientId=self._client)

    def _wait_until_still(self) -> list[int]:
        """Bodies that still move after the longest waiting time; [] as soon as all are at rest."""
        waited = 0.0
        while waited < self.config.settle_s:
            self._step(0.1)
            waited += 0.1
            moving = [body for body in self._bodies if self._moves(body)]
            if not moving:
                return []
            if all(self._left_table(body) for body in moving):
                return moving
        return moving

    def _moves(self, body: int) -> bool:
        linear, angular = self._bullet.getBaseVelocity(body, physicsClientId=self._client)
        limit = self.config.still_speed
        return bool(np.linalg.norm(linear) > limit or np.linalg.norm(angular) > 10 * limit)

    def _left_table(self, body: int) -> bool:
        position, _ = self._bullet.getBasePositionAndOrientation(body, physicsClientId=self._client)
        return bool(np.hypot(*position[:2]) > self.config.rest_radius_m or position[2] < 0)

    def _take(self, body: int) -> None:
        self._bullet.removeBody(body, physicsClientId=self._client)
        del self._bodies[body]


@contextmanager
def quiet_stdout() -> Iterator[None]:
    """Silence what a C library prints on import (pybullet's build time)."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w") as sink:
        os.dup2(sink.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)
