"""A small true scene for tests: solids on a table, seen by a depth camera through Open3D's ray casting."""

from __future__ import annotations

import numpy as np
import trimesh

from perception.camera import Camera, transform
from perception.frame import Frame

TABLE_COLOUR = (186, 172, 150)
SOLID_COLOURS = ((200, 60, 50), (60, 110, 190), (230, 180, 60))


def camera_above_table(width: int = 320, height: int = 240) -> Camera:
    """A camera 0.75 m from the table's middle, looking down at 40 degrees; the world's z axis points up."""
    pitch = np.radians(40)
    forward = np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
    right = np.array([0.0, -1.0, 0.0])
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = -0.75 * forward
    focal = 0.9 * width
    K = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    return Camera(K=K, width=width, height=height, T_world_camera=T)


def solids() -> dict[int, trimesh.Trimesh]:
    """label -> true mesh in the world frame [m]: a box, a ball and a can behind the box, on z = 0."""
    box = trimesh.creation.box((0.07, 0.12, 0.10))
    box.apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    box.apply_translation([-0.04, 0.09, 0.05])
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    ball.apply_translation([-0.02, -0.10, 0.05])
    can = trimesh.creation.cylinder(radius=0.035, height=0.12, sections=48)
    can.apply_translation([0.10, 0.02, 0.06])
    return {3: box, 7: ball, 12: can}


def render_frame(meshes: dict[int, trimesh.Trimesh], camera: Camera) -> Frame:
    """Depth, labels and plain colours of the meshes on the table z = 0, without noise."""
    import open3d as o3d

    table = trimesh.creation.box((3.0, 3.0, 0.01))
    table.apply_translation([0.5, 0, -0.005])
    scene = o3d.t.geometry.RaycastingScene()
    for mesh in (table, *meshes.values()):
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    directions = camera.rays @ camera.T_world_camera[:3, :3].T.astype(np.float32)
    origins = np.broadcast_to(transform(camera.T_world_camera, np.zeros(3, np.float32)), directions.shape)
    hits = scene.cast_rays(o3d.core.Tensor(np.concatenate([origins, directions], -1)))
    depth = hits["t_hit"].numpy()  # directions have z = 1 in the camera frame, so t is the depth
    geometry = hits["geometry_ids"].numpy().astype(np.int64)
    seen = np.isfinite(depth)
    geometry[~seen] = 0
    light = np.abs(hits["primitive_normals"].numpy() @ np.array([-0.4, 0.3, 0.87], np.float32))
    colours = np.array([TABLE_COLOUR, *(SOLID_COLOURS[i % 3] for i in range(len(meshes)))], np.float32)
    rgb = colours[geometry] * (0.45 + 0.55 * light[..., None])
    names = dict(zip(meshes, ("003_box", "ball", "can"), strict=True))
    return Frame(
        depth=np.where(seen, depth, np.nan).astype(np.float32),
        camera=camera,
        rgb=np.where(seen[..., None], rgb, 60).astype(np.uint8),
        labels=np.array([0, *meshes], np.uint16)[geometry],
        names=names,
        source="solids",
    )
