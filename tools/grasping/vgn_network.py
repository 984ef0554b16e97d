"""VGN (Volumetric Grasping Network, Breyer et al. 2020): a TSDF of 40^3 voxels to a grasp at each voxel.

Written from its description. Knows tensors and the published weights; knows nothing of scenes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from mapping.errors import DataError

SMOOTH = 1.0
"""Quality is smoothed with a Gaussian of this many voxels."""
NEAR = 2
"""Quality counts within so many voxels outside of a surface."""
QUALITY = 0.9
"""Least quality of a grasp."""
WIDTHS = (1.33, 9.33)
"""Least and largest width of a grasp [voxels]."""
PEAK = 4
"""The best voxel of so many along each axis is taken."""
LAYERS = (
    "encoder.conv1", "encoder.conv2", "encoder.conv3", "decoder.conv1", "decoder.conv2", "decoder.conv3",
    "conv_qual", "conv_rot", "conv_width",
)  # fmt: skip

Network = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""TSDF (40, 40, 40) -> quality (40, 40, 40), quaternions x y z w (40, 40, 40, 4), widths [voxels]."""


def load_network(weights: Path) -> Network:
    """The network with the weights in a file; DataError when it is no such file."""
    import torch

    try:
        state = torch.load(weights, weights_only=True, map_location="cpu")
        layers = {name: (state[f"{name}.weight"], state[f"{name}.bias"]) for name in LAYERS}
    except Exception as error:  # torch raises many types for broken files
        raise DataError(
            f"{weights}: not the weights of VGN ({error}); expected vgn_conv.pth of ethz-asl/vgn"
        ) from error

    def network(tsdf: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        with torch.no_grad():
            return _forward(torch.from_numpy(np.ascontiguousarray(tsdf, np.float32))[None, None], layers)

    return network


def _forward(x: Any, layers: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from torch import sigmoid
    from torch.nn import functional

    def conv(values: Any, name: str, stride: int = 1) -> Any:
        weight, bias = layers[name]
        return functional.conv3d(values, weight, bias, stride, padding=weight.shape[-1] // 2)

    for name in LAYERS[:3]:
        x = functional.relu(conv(x, name, stride=2))
    for name, size in zip(LAYERS[3:6], (10, 20, 40)):
        x = functional.interpolate(functional.relu(conv(x, name)), size)
    quality = sigmoid(conv(x, "conv_qual"))[0, 0]
    turns = functional.normalize(conv(x, "conv_rot"), dim=1)[0].permute(1, 2, 3, 0)
    return quality.numpy(), turns.numpy(), conv(x, "conv_width")[0, 0].numpy()


def chosen_voxels(tsdf: np.ndarray, quality: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices (N, 3) of the grasps worth trying and their quality (N,), by the published post-processing:
    smoothed, kept near surfaces outside of bodies, of possible width, above a threshold, at local maxima."""
    smooth = ndimage.gaussian_filter(quality, SMOOTH, mode="nearest")
    outside, within = tsdf > 0.5, (tsdf > 1e-3) & (tsdf < 0.5)
    valid = ndimage.binary_dilation(outside, iterations=NEAR, mask=~within)
    smooth[~valid | (widths < WIDTHS[0]) | (widths > WIDTHS[1])] = 0
    smooth[smooth < QUALITY] = 0
    peaks = (smooth == ndimage.maximum_filter(smooth, size=PEAK)) & (smooth > 0)
    index = np.argwhere(peaks)
    return index, smooth[tuple(index.T)]
