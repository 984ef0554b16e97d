"""Of which objects a view more says nothing that the map before it did not know: what was made of them stays.

Knows joint observations and the earlier map's surfaces; knows nothing of how surfaces are made.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mapping.threads import map_in_threads
from perception.views.joint import JointObservation
from reconstruction.surface.joint_surface import JointSurface
from reconstruction.surface.unchanged import unchanged
from reconstruction.warm_start import Before


def quiet_objects(observation: JointObservation, seen: JointSurface, before: Before) -> frozenset[int]:
    """Labels of objects whose surfaces the latest of several views neither passes through nor misses.

    seen: what the views measured.
    """
    earlier, latest = observation.views[:-1], observation.views[-1:]

    def quiet(index: int) -> bool:
        label = observation.objects[index].label
        surface = before.surfaces.get(label)
        if surface is None or surface.field is None or label in before.kept:
            return False
        edges = seen.edges(index)
        vertices = np.asarray(surface.mesh.vertices, np.float32)
        new, known = (partial(observation.thinned, label, seen.thinnest, of) for of in (latest, earlier))
        return unchanged(vertices, edges.views[-1], edges.spread, new(), known)

    found = map_in_threads(quiet, range(len(observation.objects)))
    return frozenset(item.label for item, stays in zip(observation.objects, found) if stays)
