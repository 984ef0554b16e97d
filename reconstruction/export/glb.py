"""glTF binary: one named node an object, coloured by how sure its surface is."""

from __future__ import annotations

from pathlib import Path

import trimesh

from reconstruction.export.export_scene import ExportScene
from reconstruction.pictures.palette import uncertainty_colours

STATEMENT = {
    "frame": "nodes in the world frame of the result (its up axis is kept, not turned to glTF's y), meshes "
    "in each "
    "object's own frame",
    "unit": "m",
    "quaternion": "none: nodes have 4x4 matrices",
    "colours": "p(uncertain) at each vertex, as in mesh.ply",
}


def write(scene: ExportScene, folder: Path) -> None:
    """scene.glb."""
    whole = trimesh.Scene()
    for item, stored in zip(scene.objects, scene.result.objects):
        mesh = trimesh.Trimesh(
            item.mesh.vertices,
            item.mesh.faces,
            vertex_colors=uncertainty_colours(stored.uncertainty),
            process=False,
        )
        whole.add_geometry(mesh, node_name=item.key, geom_name=item.key, transform=item.T_world_object)
    whole.metadata.update({"frame": "world", "unit": "m"})
    content = whole.export(file_type="glb")
    assert isinstance(content, bytes)
    (folder / "scene.glb").write_bytes(content)
