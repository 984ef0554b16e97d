"""The occlusion prior's network: a small volume encoder and a decoder for single points."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_eval

from reconstruction.prior.features import LATTICE, LATTICE_CHANNELS, RAY_NAMES
from reconstruction.prior.footprint import FOOTPRINT_NAMES
from reconstruction.prior.revolution import REVOLUTION_NAMES
from reconstruction.prior.trilinear import corners

POINT_NAMES = (*RAY_NAMES, *FOOTPRINT_NAMES, *REVOLUTION_NAMES)
"""What is known of a single point: what the rays say, the plan view, and both turned about an axis."""
POINT_CHANNELS = len(POINT_NAMES)

WIDTHS = (32, 48, 96)
"""Channels at a half, a quarter and an eighth of the lattice's resolution."""
HIDDEN = 48
"""Units in the point decoder's first layer."""


def architecture() -> dict[str, object]:
    """What weights must have been made for: stored beside them and compared when they are read."""
    return {
        "lattice": list(LATTICE),
        "lattice_channels": [*RAY_NAMES, "surface"],
        "point_channels": list(POINT_NAMES),
        "widths": list(WIDTHS),
        "hidden": HIDDEN,
    }


class PriorNetwork(nn.Module):
    """Log odds that a point lies inside the object, from its lattice and the point's own features.

    encode looks at the object as a whole, at half the lattice's resolution; decode adds what is exactly known
    at the point, so that borders are sharper than the lattice.
    """

    def __init__(self, normalised: bool = False) -> None:
        """normalised: with batch normalisation, for training; `plain` folds it into the weights."""
        super().__init__()
        fine, middle, coarse = WIDTHS

        def conv(channels: int) -> nn.Module:
            plain = nn.Conv3d(channels, channels, 3, padding=1, bias=not normalised)
            return nn.Sequential(plain, nn.BatchNorm3d(channels)) if normalised else plain

        self.enter = nn.Conv3d(LATTICE_CHANNELS, fine, 2, stride=2)
        self.fine_in = conv(fine)
        self.down = nn.Conv3d(fine, middle, 2, stride=2)
        self.middle_in = conv(middle)
        self.down_again = nn.Conv3d(middle, coarse, 2, stride=2)
        self.coarse_one = conv(coarse)
        self.coarse_two = conv(coarse)
        self.up = nn.Conv3d(coarse, middle, 1)
        self.middle_out = conv(middle)
        self.up_again = nn.Conv3d(middle, fine, 1)
        self.fine_out = conv(fine)
        self.fine_last = conv(fine)
        self.decoder = nn.Sequential(
            nn.Linear(fine + POINT_CHANNELS, HIDDEN),
            nn.ReLU(inplace=True),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(inplace=True),
            nn.Linear(HIDDEN, 1),
        )

    def encode(self, lattice: torch.Tensor) -> torch.Tensor:
        """Features (B, F, 12, 12, 8) of lattices (B, LATTICE_CHANNELS, 24, 24, 16)."""
        # The inner layers are faster with channels last; the first one's output is cheaper to turn than its
        # input.
        entered = self.enter(lattice).contiguous(memory_format=torch.channels_last_3d)
        fine = F.relu(self.fine_in(F.relu(entered)))
        middle = F.relu(self.middle_in(F.relu(self.down(fine))))
        coarse = F.relu(self.down_again(middle))
        coarse = coarse + F.relu(self.coarse_two(F.relu(self.coarse_one(coarse))))
        middle = F.relu(self.middle_out(middle + F.interpolate(self.up(coarse), scale_factor=2)))
        fine = F.relu(self.fine_out(fine + F.interpolate(self.up_again(middle), scale_factor=2)))
        return self.fine_last(fine)

    def decode(self, features: torch.Tensor, local: torch.Tensor, channels: torch.Tensor) -> torch.Tensor:
        """Log odds (B, Q) at points (B, Q, 3) in box coordinates with channels (B, Q, POINT_CHANNELS)."""
        objects, count = len(features), local.shape[1]
        owner = np.arange(objects, dtype=np.int32).repeat(count)
        near = self._near(features, owner, local.reshape(-1, 3)).reshape(objects, count, -1)
        return self.decoder(torch.cat([near, channels], dim=-1))[..., 0]  # (B, Q, F + P) to (B, Q)

    def decode_rows(
        self, features: torch.Tensor, owner: np.ndarray, local: torch.Tensor, channels: torch.Tensor
    ) -> torch.Tensor:
        """Log odds (N,) at points (N, 3) of several objects, each in its object's box coordinates, with
        channels (N, POINT_CHANNELS). owner: (N,) int32, whose features (B, ...) a point has."""
        return self.decoder(torch.cat([self._near(features, owner, local), channels], dim=-1))[:, 0]

    def _near(self, features: torch.Tensor, owner: np.ndarray, local: torch.Tensor) -> torch.Tensor:
        """Features (N, F) of their owners' at points (N, 3)."""
        objects, count, *shape = features.shape
        index, weight = corners(local.T.numpy(), shape)
        if objects > 1:
            index += owner * np.int32(np.prod(shape))
        return F.embedding_bag(
            torch.from_numpy(np.ascontiguousarray(index.T)),
            features.permute(0, 2, 3, 4, 1).reshape(-1, count),
            per_sample_weights=torch.from_numpy(np.ascontiguousarray(weight.T)),
            mode="sum",
        )

    def plain(self) -> PriorNetwork:
        """The same function without normalisation layers, ready for use."""
        network = PriorNetwork()
        for name, module in self.named_children():
            if name != "decoder" and isinstance(module, nn.Sequential):
                module = fuse_conv_bn_eval(*module.eval())
            network.get_submodule(name).load_state_dict(module.state_dict())
        return network.eval()
