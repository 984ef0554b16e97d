"""Points of a few classes in blobs, with noise: data for tests of the map."""

import numpy as np

CLASSES = 4


def blobs(dimensions: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three blobs and noise in d dimensions: X (N, d), y (N,), hinge lattice (H, d)."""
    rng = np.random.default_rng(3)
    centres = rng.uniform(-0.1, 0.1, (CLASSES - 1, dimensions))
    X = np.concatenate(
        [rng.normal(c, 0.03, (150, dimensions)) for c in centres] + [rng.uniform(-0.2, 0.2, (60, dimensions))]
    ).astype(np.float32)
    X = X.clip(-0.22, 0.22)  # all within reach of the hinge points
    y = np.repeat(np.arange(CLASSES), [150, 150, 150, 60])
    axis = np.arange(-0.2, 0.21, 0.08)
    hinges = np.stack(np.meshgrid(*[axis] * dimensions, indexing="ij"), -1).reshape(-1, dimensions)
    return X, y, hinges.astype(np.float32)
