"""What stands around the objects: a textured table in a plain room. World: z up, table top at z = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FLOOR_Z = -0.74
"""Height [m] of the floor."""
ROOM_M = (6.0, 6.0, 2.6)
"""Room extents [m]: along x and y, and from floor to ceiling."""
TEXTURE_PX_PER_M = 640
"""Resolution of the table's texture."""

WOODS = (
    ((196, 158, 116), (150, 108, 70)),
    ((222, 198, 164), (190, 158, 120)),
    ((134, 96, 66), (92, 62, 42)),
    ((196, 194, 188), (170, 168, 162)),
)
"""Light and dark tone (RGB) of each kind of table."""
WALLS = ((204, 206, 204), (190, 200, 208), (212, 204, 190))
FLOORS = ((118, 112, 106), (98, 104, 110), (140, 122, 102))


@dataclass(frozen=True)
class Surroundings:
    """Table and room. table_size: (2,) [m]. table_texture: (H, W, 3) float32 in 0..1 over the whole top."""

    table_size: tuple[float, float]
    table_texture: np.ndarray
    wall: np.ndarray
    floor: np.ndarray

    @staticmethod
    def random(table_size: tuple[float, float], rng: np.random.Generator) -> Surroundings:
        """A table and room with colours drawn by `rng`."""
        light, dark = WOODS[rng.integers(len(WOODS))]
        return Surroundings(
            table_size,
            wood(table_size, np.array(light), np.array(dark), rng),
            np.array(WALLS[rng.integers(len(WALLS))], np.float32) / 255,
            np.array(FLOORS[rng.integers(len(FLOORS))], np.float32) / 255,
        )

    @staticmethod
    def plain(table_size: tuple[float, float]) -> Surroundings:
        """Table and room without colours, for depth and labels alone."""
        grey = np.full(3, 0.6, np.float32)
        return Surroundings(table_size, np.full((1, 1, 3), 0.6, np.float32), grey, grey)

    def meshes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Vertices [m] and triangles of the table top, then of the room, in the world frame."""
        import trimesh

        table = trimesh.creation.box(extents=[*self.table_size, 0.04])
        table.apply_translation([0, 0, -0.02])
        room = trimesh.creation.box(extents=ROOM_M)
        room.apply_translation([0, 0, FLOOR_Z + ROOM_M[2] / 2])
        return [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in (table, room)]

    def color(self, part: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Colours (N, 3) in 0..1 at world positions (N, 3) of part 0 (table) or 1 (room)."""
        colors = np.empty((len(positions), 3), np.float32)
        table = part == 0
        height, width = self.table_texture.shape[:2]
        share = positions[table, :2] / np.array(self.table_size) + 0.5
        x = np.clip((share[:, 0] * width).astype(int), 0, width - 1)
        y = np.clip((share[:, 1] * height).astype(int), 0, height - 1)
        colors[table] = self.table_texture[y, x]
        low = positions[~table, 2] < FLOOR_Z + 1e-3
        colors[~table] = np.where(low[:, None], self.floor, self.wall)
        return colors


def wood(
    size: tuple[float, float], light: np.ndarray, dark: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Planks with grain along x: (H, W, 3) float32 in 0..1 for a board of `size` [m]."""
    import cv2

    width, height = (round(side * TEXTURE_PX_PER_M) for side in size)

    def noise(cells_x: int, cells_y: int) -> np.ndarray:
        coarse = rng.random((max(cells_y, 2), max(cells_x, 2)), dtype=np.float32)
        return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)

    warp = 0.6 * noise(6, 12) + 0.25 * noise(12, 60)
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (26 * rows + 3.5 * warp))
    fibre = noise(40, height // 2)
    plank = np.floor(rows * 7)
    tone = np.take(rng.uniform(-0.12, 0.12, 8).astype(np.float32), plank.astype(int))
    mix = np.clip(0.30 + 0.35 * (rings - 0.5) + 0.30 * (fibre - 0.5) + tone, 0, 1)[..., None]
    board = (light * (1 - mix) + dark * mix) / 255
    seam = np.abs(rows * 7 - np.round(rows * 7)) < 7 * 0.8 / height
    board[np.broadcast_to(seam, board.shape[:2])] *= 0.72
    return board.astype(np.float32)
