"""Of which objects a view more says nothing that the map before it did not know: what was made of them stays.

Knows joint observations and the earlier map's surfaces; knows nothing of how surfaces are made.
"""

from __future__ import annotations

import numpy as np

from mapping.known_points import first_in_cells
from mapping.threads import map_in_threads
from perception.views.joint import JointObservation
from reconstruction.surface.joint_surface import JointSurface
from reconstruction.surface.unchanged import unchanged
from reconstruction.warm_start import Before


def quiet_objects(observation: JointObservation, seen: JointSurface, before: Before) -> frozenset[int]:
    """Labels of objects whose surfaces the latest of several views neither passes through nor misses.

    seen: what the views measured.
    """
    latest = {item.label: item.points for item in observation.views[-1].observation.objects}

    def thin(points: np.ndarray) -> np.ndarray:
        return points[first_in_cells(points, seen.thinnest)]

    def quiet(index: int) -> bool:
        item = observation.objects[index]
        surface = before.surfaces.get(item.label)
        if surface is None or surface.field is None or item.label in before.kept:
            return False
        edges = seen.edges(index)
        points = latest.get(item.label, np.empty((0, 3), np.float32))
        vertices = np.asarray(surface.mesh.vertices, np.float32)
        earlier = item.points[: len(item.points) - len(points)]  # the latest view's come last
        return unchanged(vertices, edges.views[-1], edges.spread, thin(points), lambda: thin(earlier))

    found = map_in_threads(quiet, range(len(observation.objects)))
    return frozenset(item.label for item, stays in zip(observation.objects, found) if stays)
