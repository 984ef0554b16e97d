"""`python -m tools.ball_drops RESULT ...`: do open containers stay open as physics engines see them?

Each mesh that would hold water is a container. A ball of 2 cm is dropped into it in pybullet and in MuJoCo,
onto the exported convex parts of all objects: a hollow that the parts close throws it out.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from tools.exit_code import exit_code
from tools.options import write_json

if TYPE_CHECKING:
    import trimesh

    from reconstruction.export.export_scene import ExportScene

RADIUS, MASS = 0.01, 0.01
"""Of the ball [m, kg]."""
ABOVE = 0.03
"""It is let go this far above the place where the hollow would overflow [m]."""
SECONDS, STEP = 1.5, 1 / 480
"""Time simulated, and the physics' step [s]."""
CELL = 0.002
"""Of the height map in which hollows are found [m]."""
DEPTH, ROOM = 0.03, 0.016
"""A container is deeper than this, and has room for a ball of this radius where it is 2 cm deep [m]."""


@dataclass(frozen=True)
class Hollow:
    """Where an object would hold water, in the table frame.

    middle: (2,) the place with most room; radius: room there; top: height at which it overflows; depth: below
    that [m].
    """

    middle: tuple[float, float]
    radius: float
    top: float
    depth: float


@dataclass(frozen=True)
class Drop:
    """Where a ball came to rest. held: whether within the hollow's reach and below its overflow."""

    result: str
    key: str
    engine: str
    held: bool
    depth: float


def check(
    results: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")],
    *,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Drop a ball into every container of results, in two physics engines.

    Example: python -m tools.ball_drops results/* --json balls.json

    Args:
        results: Result folders of `contramap map`.
        json: Also write the figures to this file.
    """
    from tqdm import tqdm

    from reconstruction.export.export_scene import ExportScene
    from reconstruction.files.result_folder import load_result

    drops: list[Drop] = []
    for result in tqdm(results, desc="results", disable=None):
        with tempfile.TemporaryDirectory() as folder:
            drops += drop_all(ExportScene(load_result(result)), Path(folder))
    for drop in drops:
        print(f"{drop.result} {drop.key} {drop.engine}: {'held' if drop.held else 'LOST'}")
    summary = {}
    for engine in ("mujoco", "pybullet"):
        held = [drop.held for drop in drops if drop.engine == engine]
        summary[engine] = {"containers": len(held), "held": sum(held)}
        print(f"{engine}: {sum(held)} of {len(held)} containers hold the ball")
    write_json({"summary": summary, "drops": [asdict(drop) for drop in drops]}, json)


def drop_all(scene: ExportScene, out: Path) -> list[Drop]:
    """A ball into each container of a result that no other object fills or covers, in either engine; what is
    exported comes into `out`."""
    from perception.camera import invert_rigid, transform
    from reconstruction.export.export_object import moved
    from reconstruction.export.formats import export

    T_table_world = invert_rigid(scene.T_world_table)
    meshes = {item.key: moved(item.mesh, T_table_world @ item.T_world_object) for item in scene.objects}
    hollows = {}
    for key, mesh in meshes.items():
        found = hollow(*height_map(np.asarray(mesh.vertices), mesh.faces))
        others = [other for name, other in meshes.items() if name != key]
        if found is not None and not covered(found, others):
            hollows[key] = found
    if not hollows:
        return []
    export(scene, ["urdf", "mjcf"], out)
    drops = []
    for key, place in hollows.items():
        start = np.array([*place.middle, place.top + ABOVE])
        for engine, run in (("mujoco", _mujoco), ("pybullet", _pybullet)):
            end = transform(T_table_world, run(out, transform(scene.T_world_table, start[None])[0])[None])[0]
            away = float(np.linalg.norm(end[:2] - place.middle))
            held = end[2] < place.top and away < place.radius + place.depth
            drops.append(Drop(scene.result.folder.name, key, engine, bool(held), place.depth))
    return drops


def height_map(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights (nx, ny) [m] of a surface seen from above, -inf beside it, and the place (2,) of cell 0, 0."""
    import trimesh

    from reconstruction.solid import Solid

    low, high = vertices.min(0) - 2 * CELL, vertices.max(0) + 2 * CELL
    axes = [np.arange(low[i], high[i], CELL) for i in range(2)]
    x, y = np.meshgrid(*axes, indexing="ij")
    origins = np.stack([x, y, np.full_like(x, high[2])], -1).reshape(-1, 3)
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), origins.shape)
    fall = Solid(trimesh.Trimesh(vertices, faces, process=False)).cast(origins, down)
    return np.where(np.isfinite(fall), high[2] - fall, -np.inf).reshape(x.shape), low[:2]


def hollow(heights: np.ndarray, origin: np.ndarray) -> Hollow | None:
    """The largest hollow of a height map (nx, ny) [m]; None where none is a container."""
    from scipy import ndimage
    from skimage.morphology import reconstruction

    ground = heights[np.isfinite(heights)].min()
    solid = np.where(np.isfinite(heights), heights, ground)
    seed = solid.copy()
    seed[1:-1, 1:-1] = solid.max()
    water = reconstruction(seed, solid, method="erosion")
    depth = water - solid
    room = ndimage.distance_transform_edt(depth > 2 * RADIUS) * CELL
    middle = np.unravel_index(room.argmax(), room.shape)
    if room[middle] < ROOM or depth[middle] < DEPTH:
        return None
    place = origin + CELL * np.array(middle)
    return Hollow(
        (float(place[0]), float(place[1])), float(room[middle]), float(water[middle]), float(depth[middle])
    )


def covered(place: Hollow, others: Sequence[trimesh.Trimesh]) -> bool:
    """Whether another object is where the ball falls: in the hollow, or above it."""
    from reconstruction.solid import Solid

    around = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * RADIUS + place.middle
    high = place.top + 1.0
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(around), 3))
    starts = np.column_stack([around, np.full(len(around), high)])
    return any((high - Solid(mesh).cast(starts, down) > place.top - place.depth).any() for mesh in others)


def _mujoco(out: Path, start: np.ndarray) -> np.ndarray:
    """Where the ball (3,) [m, world] is in the end."""
    import mujoco

    path = out / "mjcf" / "scene.xml"
    ball = f'<freejoint/><geom type="sphere" size="{RADIUS}" mass="{MASS}"/>'
    place = " ".join(f"{value:.6f}" for value in start)
    text = path.read_text().replace(
        "</worldbody>", f'<body name="ball" pos="{place}">{ball}</body></worldbody>'
    )
    with_ball = path.with_name("with_ball.xml")
    with_ball.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(with_ball))
    model.opt.timestep = STEP
    data = mujoco.MjData(model)
    for _ in range(round(SECONDS / STEP)):
        mujoco.mj_step(model, data)
    return np.array(data.xpos[model.body("ball").id])


def _pybullet(out: Path, start: np.ndarray) -> np.ndarray:
    """Where the ball (3,) [m, world] is in the end."""
    from tools.export_checks import bullet_scene

    with bullet_scene(out) as (bullet, client, _):
        shape = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=RADIUS, physicsClientId=client)
        ball = bullet.createMultiBody(MASS, shape, -1, start.tolist(), physicsClientId=client)
        for _ in range(round(SECONDS / STEP)):
            bullet.stepSimulation(physicsClientId=client)
        return np.array(bullet.getBasePositionAndOrientation(ball, physicsClientId=client)[0])


def main() -> int:
    """Run the command line."""
    return exit_code("ball_drops", lambda: tyro.cli(check, prog="python -m tools.ball_drops"))


if __name__ == "__main__":
    sys.exit(main())
