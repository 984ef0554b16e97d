"""How wide what sticks out of a body of revolution is in images: a handle is about as thick as it is wide.

Knows one object's pixels in depth images and the body; knows nothing of maps and lattices.
"""

from __future__ import annotations

import numpy as np

from perception.camera import invert_rigid, transform
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.profile_depth import NEAR
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.seen_surface import Edges


def handle_width(edges: Edges | JointEdges, body: RoundBody) -> float:
    """Usual width [m] of what sticks out of a body by more than NEAR, in the view where it is widest; 0 where
    nothing does."""
    views = edges.views if isinstance(edges, JointEdges) else (edges,)
    return max(_width(view, body) for view in views)


def _width(view: Edges, body: RoundBody) -> float:
    import cv2

    if view.index < 0:
        return 0.0
    seen, part = view.seen, view.seen.boxes[view.index]
    own = seen.owner[part] == view.index
    points = seen.camera.rays[part][own] * seen.depth[part][own][:, None]
    off = body.depth(transform(invert_rigid(seen.T_camera_table), points)) < -NEAR
    if not off.any():
        return 0.0
    image = np.zeros((own.shape[0] + 2, own.shape[1] + 2), np.uint8)
    image[1:-1, 1:-1][own] = off
    within = cv2.distanceTransform(image, cv2.DIST_L2, 5)[image > 0] - 0.5  # from the border of the pixel
    pixel = float(np.median(points[off, 2])) / float(min(seen.camera.K[0, 0], seen.camera.K[1, 1]))
    return 4 * pixel * float(np.median(within))  # in a strip, pixels are evenly as far from its sides
