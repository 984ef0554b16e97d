"""Which of many views to keep: cost and memory of a map that grows are to stay as they are.

Knows camera poses and which objects each view sees; knows nothing of what the views show of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.camera import Camera
from perception.views.joint import View


def without_the_least_new(views: Sequence[View], most: int, to_come: Camera) -> tuple[View, ...]:
    """At most `most` views besides the one of a camera to come: while there are more, the one goes that was
    taken nearest to another. The first stays, whose table frame is everyone's, and so does one that alone
    sees some object."""
    kept = list(views)
    while len(kept) > max(most, 1):
        places = np.array([view.frame.camera.T_world_camera[:3, 3] for view in kept])
        places = np.concatenate([places, to_come.T_world_camera[None, :3, 3]])
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        np.fill_diagonal(apart, np.inf)
        often = [label for view in kept for label in view.labels]
        candidates = [
            index
            for index, view in enumerate(kept)
            if index and all(often.count(label) > 1 for label in view.labels)
        ]
        if not candidates:
            break
        del kept[min(candidates, key=lambda index: float(apart[index].min()))]
    return tuple(kept)
