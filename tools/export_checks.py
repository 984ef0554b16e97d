"""`python -m tools.export_checks RESULT ...`: what physics engines make of exported results.

Exports each result as URDF and MJCF, loads it into pybullet and MuJoCo as it stands, and lets two seconds
pass: which objects are accepted, which move away from where they were seen, which overlap, and how long the
export took.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import tyro

from tools.exit_code import exit_code
from tools.options import write_json

SECONDS, STEP = 2.0, 1 / 480
"""Time simulated, and the physics' step [s]."""
MOVED_M, TURNED_DEG = 0.01, 5.0
"""What still counts as at rest."""


@dataclass(frozen=True)
class Motion:
    """How one object moved [m, deg]."""

    result: str
    key: str
    engine: str
    moved: float
    turned: float

    @property
    def rested(self) -> bool:
        return self.moved < MOVED_M and self.turned < TURNED_DEG


def check(
    results: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")],
    *,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Load exported results into pybullet and MuJoCo and let them stand for two seconds.

    Example: python -m tools.export_checks results/* --json export_checks.json

    Args:
        results: Result folders of `contramap map`.
        json: Also write the figures to this file.
    """
    from tqdm import tqdm

    motions: list[Motion] = []
    figures: list[dict[str, Any]] = []
    for result in tqdm(results, desc="results", disable=None):
        with tempfile.TemporaryDirectory() as folder:
            figures.append(export_one(result, Path(folder)))
            motions += stand(result, Path(folder))
    summary = summarise(figures, motions)
    for name, value in summary.items():
        print(f"{name:28} {value}")
    rows = [asdict(motion) for motion in motions]
    write_json({"summary": summary, "results": figures, "motions": rows}, json)


def export_one(result: Path, out: Path) -> dict[str, Any]:
    """Export to urdf and mjcf; seconds, and for either parts and their error by object."""
    from reconstruction.export import mjcf, urdf
    from reconstruction.export.export_scene import ExportScene
    from reconstruction.export.formats import export
    from reconstruction.files.result_folder import load_result

    start = perf_counter()
    scene = ExportScene(load_result(result))
    export(scene, ["urdf", "mjcf"], out)
    bodies = {"urdf": scene.bodies(urdf.GAP), "mjcf": scene.bodies(mjcf.GAP)}
    return {
        "result": result.name,
        "seconds": round(perf_counter() - start, 3),
        "overlap_mm": round(1e3 * overlap(out), 3),
        "collision": {name: of_one.collision_statement() for name, of_one in bodies.items()},
        "unseen_supports": {name: sorted(of_one.unseen_supports) for name, of_one in bodies.items()},
    }


def overlap(out: Path) -> float:
    """How deep any two convex parts of different objects, or one and the support, are in each other as
    exported [m]; 0 where none are."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(out / "mjcf" / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return max((-float(data.contact[i].dist) for i in range(data.ncon)), default=0.0)


def stand(result: Path, out: Path) -> Iterator[Motion]:
    """Two seconds in either engine."""
    for engine, run in (("mujoco", _mujoco), ("pybullet", _pybullet)):
        for key, (before, after) in run(out).items():
            from scipy.spatial.transform import Rotation

            turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).magnitude()
            moved = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
            yield Motion(result.name, key, engine, moved, float(np.degrees(turn)))


def summarise(figures: list[dict[str, Any]], motions: list[Motion]) -> dict[str, Any]:
    """The figures in one flat dict."""
    summary: dict[str, Any] = {
        "results": len(figures),
        "overlap_mm_max": float(np.max([figure["overlap_mm"] for figure in figures])),
    }
    for name in figures[0]["collision"]:
        parts = [entry for figure in figures for entry in figure["collision"][name].values()]
        errors = np.array([max(entry["missing_mm"], entry["excess_mm"]) for entry in parts])
        summary |= {
            "objects": len(parts),
            "export_s_per_object": sum(figure["seconds"] for figure in figures) / max(len(parts), 1),
            f"{name}_convex_parts_median": float(np.median([entry["parts"] for entry in parts])),
            f"{name}_error_mm_median": float(np.median(errors)),
            f"{name}_error_mm_90": float(np.quantile(errors, 0.9)),
            f"{name}_error_mm_max": float(errors.max()),
            f"{name}_error_3mm": round(float((errors <= 3.0).mean()), 4),
            f"{name}_error_4mm": round(float((errors <= 4.0).mean()), 4),
            f"{name}_on_unseen_supports": sum(len(figure["unseen_supports"][name]) for figure in figures),
        }
    for engine in ("mujoco", "pybullet"):
        mine = [motion for motion in motions if motion.engine == engine]
        summary[f"{engine}_loaded"] = len(mine)
        summary[f"{engine}_at_rest"] = round(float(np.mean([motion.rested for motion in mine])), 4)
        summary[f"{engine}_moved_mm_median"] = round(1e3 * float(np.median([m.moved for m in mine])), 2)
    return summary


def _mujoco(out: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Key -> centre of mass and axes (4, 4) before and after; inertia="exact" refuses meshes that are not
    closed."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(out / "mjcf" / "scene.xml"))
    model.opt.timestep = STEP
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before = _bodies(model, data)
    for _ in range(round(SECONDS / STEP)):
        mujoco.mj_step(model, data)
    after = _bodies(model, data)
    return {key: (before[key], after[key]) for key in before}


def _bodies(model: Any, data: Any) -> dict[str, np.ndarray]:
    found = {}
    for body in range(1, model.nbody):
        T = np.eye(4)
        T[:3, :3] = data.ximat[body].reshape(3, 3)
        T[:3, 3] = data.xipos[body]
        found[model.body(body).name] = T
    return found


def _pybullet(out: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    with bullet_scene(out) as (bullet, client, bodies):
        before = {key: _pose(bullet, body, client) for key, body in bodies.items()}
        for _ in range(round(SECONDS / STEP)):
            bullet.stepSimulation(physicsClientId=client)
        return {key: (before[key], _pose(bullet, body, client)) for key, body in bodies.items()}


@contextmanager
def bullet_scene(out: Path) -> Iterator[tuple[Any, int, dict[str, int]]]:
    """pybullet, its client, and key -> body of an exported scene on its support."""
    import json

    from reconstruction.export.urdf import UNSEEN
    from sim_scenes.tabletop import quiet_stdout

    with quiet_stdout():
        import pybullet as bullet
    poses = json.loads((out / "urdf" / "poses.json").read_text())
    client = bullet.connect(bullet.DIRECT)
    try:
        bullet.setGravity(*(-9.81 * np.array(poses["up"])), physicsClientId=client)
        bullet.setTimeStep(STEP, physicsClientId=client)
        support = poses["support"]
        if support is not None:
            half = [1.0, 1.0, 0.05]
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
            middle = np.array(support["position"]) - 0.05 * np.array(poses["up"])
            bullet.createMultiBody(
                0, shape, -1, middle.tolist(), support["quaternion_xyzw"], physicsClientId=client
            )
        if (out / "urdf" / UNSEEN).is_file():
            bullet.loadURDF(str(out / "urdf" / UNSEEN), useFixedBase=True, physicsClientId=client)
        bodies = {
            key: bullet.loadURDF(
                str(out / "urdf" / f"{key}.urdf"),
                pose["position"],
                pose["quaternion_xyzw"],
                flags=bullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
            for key, pose in poses["objects"].items()
        }
        for body in bodies.values():
            # Hulls would otherwise keep a gap of millimetres.
            bullet.changeDynamics(body, -1, collisionMargin=0.0002, physicsClientId=client)
        yield bullet, client, bodies
    finally:
        bullet.disconnect(client)


def _pose(bullet: Any, body: int, client: int) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    position, turn = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(turn).as_matrix()
    T[:3, 3] = position
    return T


def main() -> int:
    """Run the command line."""
    return exit_code("export_checks", lambda: tyro.cli(check, prog="python -m tools.export_checks"))


if __name__ == "__main__":
    sys.exit(main())
