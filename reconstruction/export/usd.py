"""USD: scene.usda with a rigid body an object: a visible mesh, convex colliders, mass and inertia
(usd-core)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from reconstruction.export.export_object import ExportObject
from reconstruction.export.export_scene import ExportScene

GAP = 0.0
"""Between parts of two objects [m]: colliders rest on each other without any."""
STATEMENT = {
    "frame": "prims' transforms lead from each object's own frame to the world frame of the result",
    "unit": "m (metersPerUnit 1), kg; upAxis Z",
    "quaternion": "xformOp:orient, GfQuatd: w x y z",
}


def write(scene: ExportScene, folder: Path) -> None:
    """scene.usda; /World/<key> are the bodies, a key that begins with a digit gets `object_` before it."""
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.CreateNew(str(folder / "scene.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetMetadata("comment", "contramap: world frame, m, kg, quaternions w x y z")
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    physics = UsdPhysics.Scene.Define(stage, "/World/physics")
    physics.CreateGravityDirectionAttr(Gf.Vec3f(*(-scene.up).tolist()))
    physics.CreateGravityMagnitudeAttr(9.81)
    for item in scene.objects:
        _body(stage, item, scene)
        _unseen_support(stage, item, scene)
    stage.GetRootLayer().Save()


def _body(stage: Any, item: ExportObject, scene: ExportScene) -> None:
    from pxr import Gf, Tf, UsdGeom, UsdPhysics

    path = f"/World/{Tf.MakeValidIdentifier('object_' + item.key)}"
    body = UsdGeom.Xform.Define(stage, path)
    body.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*item.position))
    body.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*item.quaternion_wxyz))
    prim = body.GetPrim()
    prim.SetCustomDataByKey("label", item.label)
    prim.SetCustomDataByKey("name", item.name)
    UsdPhysics.RigidBodyAPI.Apply(prim)
    _mass(prim, item, scene.bodies(GAP).centres[item.label], scene.config.density)
    _mesh(stage, f"{path}/visual", item.mesh)
    for index, part in enumerate(scene.bodies(GAP).parts[item.label].parts):
        collider = _mesh(stage, f"{path}/collision/part_{index:03d}", part.mesh)
        UsdPhysics.CollisionAPI.Apply(collider.GetPrim())
        UsdPhysics.MeshCollisionAPI.Apply(collider.GetPrim()).CreateApproximationAttr("convexHull")
        UsdGeom.Imageable(collider).CreatePurposeAttr(UsdGeom.Tokens.guide)


def _unseen_support(stage: Any, item: ExportObject, scene: ExportScene) -> None:
    """Colliders that are no bodies: what holds an object up is not known to move."""
    from pxr import Gf, Tf, UsdGeom, UsdPhysics

    for index, (position, wxyz, size) in enumerate(scene.bodies(GAP).unseen_blocks(item.label)):
        name = Tf.MakeValidIdentifier(f"object_{item.key}_unseen_support_{index:02d}")
        block = UsdGeom.Cube.Define(stage, f"/World/{name}")
        block.CreateSizeAttr(1.0)
        block.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*position.tolist()))
        block.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*wxyz.tolist()))
        block.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*size.tolist()))
        UsdPhysics.CollisionAPI.Apply(block.GetPrim())
        block.CreatePurposeAttr(UsdGeom.Tokens.guide)


def _mass(prim: Any, item: ExportObject, centre: np.ndarray, density: float) -> None:
    from pxr import Gf, UsdPhysics
    from scipy.spatial.transform import Rotation

    mass, _, tensor = item.inertia(density)
    diagonal, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    x, y, z, w = Rotation.from_matrix(axes).as_quat(canonical=True)
    api = UsdPhysics.MassAPI.Apply(prim)
    api.CreateMassAttr(mass)
    api.CreateCenterOfMassAttr(Gf.Vec3f(*centre.tolist()))
    api.CreateDiagonalInertiaAttr(Gf.Vec3f(*diagonal.tolist()))
    api.CreatePrincipalAxesAttr(Gf.Quatf(float(w), float(x), float(y), float(z)))


def _mesh(stage: Any, path: str, mesh: trimesh.Trimesh) -> Any:
    from pxr import UsdGeom, Vt

    prim = UsdGeom.Mesh.Define(stage, path)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(mesh.vertices, np.float32)))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.asarray(mesh.faces, np.int32).ravel()))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.asarray(mesh.bounds, np.float32)))
    return prim
