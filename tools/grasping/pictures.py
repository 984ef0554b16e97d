"""Pictures of grasps: what the planner believed with the hand in it, beside what was truly there.

Knows looks at a table and grasps; knows nothing of planners.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mapping.files import write_atomically
from perception.camera import transform
from reconstruction.pictures.palette import object_colour
from reconstruction.pictures.shading import frame_meshes, render
from tools.grasping.attempt import Outcome
from tools.grasping.hand import Grasp, HandConfig, hand_mesh
from tools.grasping.play import Seen

SIZE = (320, 260)
"""Of one of the two panels [px]."""
HAND = np.array([60, 60, 66])
"""Colour of the hand [RGB]."""
GROUND = (np.array([0.0, 0.0, 1.0]), 0.0)
DOT = 0.0015
"""Radius of a measured point in pictures of clouds [m]."""
MOST_DOTS = 600


class Album:
    """Draws each attempt of one round into a PNG of its own: <name>_<attempt>_<what came of it>.png."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name

    def __call__(self, seen: Seen, grasp: Grasp, outcome: Outcome, number: int) -> None:
        """Draw one attempt."""
        import cv2

        picture = picture_of(seen, grasp, outcome)
        _, content = cv2.imencode(".png", picture[..., ::-1])
        self.folder.mkdir(parents=True, exist_ok=True)
        reason = "_".join(word for word in (outcome.reason, outcome.touched) if word)
        path = self.folder / f"{self.name.replace(' ', '_')}_{number}_{reason}.png"
        write_atomically(path, content.tobytes())


def picture_of(seen: Seen, grasp: Grasp, outcome: Outcome) -> np.ndarray:
    """(H, W, 3) uint8 RGB: left the planner's shapes, right the truth, both with the hand at the grasp."""
    hand = hand_mesh(grasp, HandConfig())
    true = [
        trimesh.Trimesh(
            transform(item.T_world_object, np.asarray(item.model.mesh.vertices, float)),
            item.model.mesh.faces,
            process=False,
        )
        for item in seen.placed
    ]
    told = dict(seen.shapes.meshes)
    told |= {label: _dots(cloud.points) for label, cloud in seen.shapes.clouds.items()}
    # From the camera's side, a little higher: what the camera could see faces the viewer.
    forward = seen.camera.T_world_camera[:3, 2]
    camera = frame_meshes([*true, hand], forward, np.array([0.0, 0.0, 1.0]), SIZE)
    panels = [
        render(
            [*meshes.values(), hand],
            [_painted(mesh, np.array(object_colour(label - 1))) for label, mesh in meshes.items()]
            + [_painted(hand, HAND)],
            camera,
            GROUND,
        )
        for meshes in (told, dict(enumerate(true, start=1)))
    ]
    colour = (36, 140, 70) if outcome.success else (190, 50, 40)
    picture = np.concatenate(panels, axis=1)
    picture[:4] = picture[-4:] = colour
    return picture


def contact_sheet(paths: list[Path], columns: int, out: Path) -> None:
    """Several pictures of one size in one PNG, row by row; files that are no pictures are left out."""
    import cv2

    images = [image for path in paths if (image := cv2.imread(str(path))) is not None]
    if not images:
        return
    height, width = images[0].shape[:2]
    rows = -(-len(images) // columns)
    sheet = np.full((rows * height, columns * width, 3), 255, np.uint8)
    for index, image in enumerate(images):
        row, column = divmod(index, columns)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = image
    write_atomically(out, cv2.imencode(".png", sheet)[1].tobytes())


def _painted(mesh: trimesh.Trimesh, colour: np.ndarray) -> np.ndarray:
    return np.tile(np.asarray(colour, float)[:3], (len(mesh.vertices), 1))


def _dots(points: np.ndarray) -> trimesh.Trimesh:
    """Measured points as small balls."""
    dot = trimesh.creation.icosphere(0, DOT)
    chosen = points[:: max(1, len(points) // MOST_DOTS)]
    vertices = (chosen[:, None] + dot.vertices).reshape(-1, 3)
    faces = (len(dot.vertices) * np.arange(len(chosen))[:, None, None] + dot.faces).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, process=False)
