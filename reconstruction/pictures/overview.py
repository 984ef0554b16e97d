"""overview.png: one picture that says what was seen, what was reconstructed and where the map is unsure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from PIL import Image, ImageDraw

from reconstruction.pictures.colour_bar import PAPER, TEXT_COLOUR, colour_bar, font
from reconstruction.pictures.near_origin import near_origin
from reconstruction.pictures.palette import OTHER_COLOUR, object_colour, uncertainty_colours
from reconstruction.pictures.shading import View, cast, frame_meshes
from reconstruction.pictures.slices import slice_uncertainty, table_axes
from reconstruction.pictures.tags import Tag, draw_tags

if TYPE_CHECKING:
    from reconstruction.result import ReconstructedObject, Reconstruction


WIDTH = 1600
PANEL = (508, 381)  # three panels a row
GAP = 19
TITLE = 34
FAINT = (122, 128, 138)
SIDE_AZIMUTH = 28.0  # [degrees] off the sensor's heading, so that two sides of each object show
LONGEST_BAR = 130  # [px]
BESIDE = 0.03  # [m] what stands this close to the objects, without a label, is drawn in grey
SIDE_ELEVATION = 30.0  # [degrees] above the table


def draw_overview(
    reconstruction: Reconstruction, path: Path, truth: Mapping[int, trimesh.Trimesh] | None = None
) -> None:
    """Write the overview as PNG: photo, meshes from two sides in two colourings, a slice, a legend.

    truth: label -> true mesh in the world frame [m]; its cut is dashed into the slice.
    """
    import io

    from mapping.files import write_atomically

    buffer = io.BytesIO()
    compose_overview(*near_origin(reconstruction, truth)).save(buffer, format="PNG")
    write_atomically(Path(path), buffer.getvalue())


def compose_overview(
    reconstruction: Reconstruction, truth: Mapping[int, trimesh.Trimesh] | None = None
) -> Image.Image:
    """The overview as an RGB image, WIDTH px wide."""
    objects = reconstruction.objects
    plain = [np.tile(_colour(item), (len(item.mesh.vertices), 1)) for item in objects]
    unsure = [uncertainty_colours(item.uncertainty) for item in objects]
    beside = _beside(reconstruction)
    if beside is not None:
        grey = np.tile(OTHER_COLOUR, (len(beside.vertices), 1))
        plain, unsure = [*plain, grey], [*unsure, grey]
    front, behind = (_side_view(reconstruction, beside, turn) for turn in (0.0, 180.0))
    section, height = _slice_panel(reconstruction, truth)
    surface = "above the table" if reconstruction.observation.support is not None else "along up"
    panels = [
        ("Input with instance outlines", _photo_panel(reconstruction)),
        ("Meshes, from the camera's side", _paint(front, plain)),
        ("Meshes, from behind", _paint(behind, plain)),
        (f"p(uncertain), slice {100 * height:.0f} cm {surface}", section),
        ("p(uncertain) on the surface, camera's side", _paint(front, unsure)),
        ("p(uncertain) on the surface, from behind", _paint(behind, unsure)),
    ]
    legend = _legend(reconstruction, truth is not None)
    row = TITLE + PANEL[1] + GAP
    page = Image.new("RGB", (WIDTH, GAP // 2 + 2 * row + legend.height), PAPER)
    draw = ImageDraw.Draw(page)
    for index, (title, picture) in enumerate(panels):
        x = GAP + (index % 3) * (PANEL[0] + GAP)
        y = GAP // 2 + (index // 3) * row
        draw.text((x, y + TITLE / 2), title, TEXT_COLOUR, font(18), anchor="lm")
        page.paste(picture, (x, y + TITLE))
    page.paste(legend, (0, GAP // 2 + 2 * row))
    return page


def _beside(reconstruction: Reconstruction) -> trimesh.Trimesh | None:
    """The obstacles without a label, as far as they stand among the objects: a wall would hide them."""
    if reconstruction.other is None or not reconstruction.objects:
        return None
    meshes = [item.mesh for item in reconstruction.objects]
    low = np.min([mesh.bounds[0] for mesh in meshes], axis=0) - BESIDE
    high = np.max([mesh.bounds[1] for mesh in meshes], axis=0) + BESIDE
    other = reconstruction.other.mesh
    among = ((other.triangles_center > low) & (other.triangles_center < high)).all(1)
    if not among.any():
        return None
    return trimesh.Trimesh(other.vertices, other.faces[among], process=False)


def _side_view(reconstruction: Reconstruction, beside: trimesh.Trimesh | None, turn: float) -> View | None:
    """Rays of a camera at `turn` [degrees] around the objects, 0 = the sensor's side, with what stands
    beside them."""
    if not reconstruction.objects:
        return None
    forward, left, up = table_axes(reconstruction)
    azimuth, elevation = np.radians(SIDE_AZIMUTH + turn), np.radians(SIDE_ELEVATION)
    heading = np.cos(azimuth) * forward + np.sin(azimuth) * left
    direction = np.cos(elevation) * heading - np.sin(elevation) * up
    meshes = [item.mesh for item in reconstruction.objects]
    ground = None
    if reconstruction.observation.support is not None:
        ground = (up, -float(up @ reconstruction.T_world_table[:3, 3]))
    camera = frame_meshes(meshes, direction, up, PANEL)
    return cast(meshes if beside is None else [*meshes, beside], camera, ground)


def _paint(view: View | None, colours: list[np.ndarray]) -> Image.Image:
    return Image.new("RGB", PANEL, (247, 248, 250)) if view is None else Image.fromarray(view.paint(colours))


def _photo_panel(reconstruction: Reconstruction) -> Image.Image:
    """The colour image (else grey depth) around the objects, with their outlines and names."""
    import cv2

    frame, labels = reconstruction.frame, reconstruction.observation.first.labels
    photo = frame.rgb if frame.rgb is not None else _grey_depth(frame.depth)
    left, top, right, bottom = _window(labels > 0)
    photo, labels = photo[top:bottom, left:right], labels[top:bottom, left:right]
    scale = min(PANEL[0] / labels.shape[1], PANEL[1] / labels.shape[0])
    size = (round(labels.shape[1] * scale), round(labels.shape[0] * scale))
    canvas = cv2.resize(photo, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    corner = ((PANEL[0] - size[0]) // 2, (PANEL[1] - size[1]) // 2)
    tags = []
    for item in reconstruction.objects:
        mask = cv2.resize((labels == item.label).astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        mask = cv2.GaussianBlur(mask, (0, 0), max(scale, 0.5))  # rounds the steps of enlarged pixels
        contours, _ = cv2.findContours(
            (mask > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        cv2.drawContours(canvas, contours, -1, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.drawContours(canvas, contours, -1, _colour(item), 2, cv2.LINE_AA)
        place = np.zeros(PANEL[::-1], bool)
        place[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]] = mask > 0.5
        tags.append(Tag(_shorten(item.name, 22), _colour(item), place))
    panel = Image.new("RGB", PANEL, (247, 248, 250))
    panel.paste(Image.fromarray(canvas), corner)
    draw_tags(ImageDraw.Draw(panel), tags)
    return panel


def _window(mask: np.ndarray, margin: float = 0.4, zoom: float = 2.0) -> tuple[int, int, int, int]:
    """Left, top, right, bottom [px] of the part to show: the mask with a margin, in the panel's shape."""
    height, width = mask.shape
    if not mask.any():
        return 0, 0, width, height
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    tall = max((rows[-1] - rows[0]) * (1 + margin), height / zoom)
    wide = max((columns[-1] - columns[0]) * (1 + margin), width / zoom, tall * PANEL[0] / PANEL[1])
    wide = min(wide, width)
    tall = min(max(tall, wide * PANEL[1] / PANEL[0]), height)
    left = np.clip((columns[0] + columns[-1] - wide) / 2, 0, width - wide)
    top = np.clip((rows[0] + rows[-1] - tall) / 2, 0, height - tall)
    return int(left), int(top), int(left + wide), int(top + tall)


def _grey_depth(depth: np.ndarray) -> np.ndarray:
    """Depth (H, W) [m] as (H, W, 3) uint8, near = light, missing = black."""
    near, far = np.nanpercentile(depth, [1, 99])
    grey = 230 - 180 * np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    return np.repeat(np.nan_to_num(grey).astype(np.uint8)[..., None], 3, axis=2)


def _slice_panel(
    reconstruction: Reconstruction, truth: Mapping[int, trimesh.Trimesh] | None
) -> tuple[Image.Image, float]:
    """The slice with the outlines of meshes (and of the truth, dashed), a scale bar; and its height [m]."""
    import cv2

    if not reconstruction.objects:
        return Image.new("RGB", PANEL, (247, 248, 250)), 0.0
    section = slice_uncertainty(reconstruction)
    values = cv2.resize(section.values.astype(np.float32), PANEL, interpolation=cv2.INTER_LINEAR)
    canvas = np.ascontiguousarray(uncertainty_colours(values))
    zoom = np.array(PANEL) / np.array(section.values.shape[::-1])

    def draw(mesh: trimesh.Trimesh, colour: tuple[int, int, int], thickness: int, dash: bool = False) -> None:
        segments = (section.outline(mesh) + 0.5) * zoom - 0.5
        if dash:
            segments = _dashes(segments)
        fixed = np.round(np.clip(segments, -1e4, 1e4) * 16).astype(np.int32)  # 4 fractional bits
        cv2.polylines(canvas, list(fixed), False, colour, thickness, cv2.LINE_AA, shift=4)

    for item in reconstruction.objects:
        draw(item.mesh, (255, 255, 255), 5)
        draw(item.mesh, _colour(item), 3)
    for mesh in (truth or {}).values():
        draw(mesh, (255, 255, 255), 2, dash=True)  # a light rim, to be seen on dark blue
        draw(mesh, (20, 20, 24), 1, dash=True)
    panel = Image.fromarray(canvas)
    centimetres, bar = _scale_bar(section.spacing / zoom[0])
    y = PANEL[1] - 16
    pen = ImageDraw.Draw(panel)
    pen.rounded_rectangle((10, y - 24, 26 + max(bar, 44), y + 8), 5, (255, 255, 255))
    pen.line((18, y, 18 + bar, y), TEXT_COLOUR, 3)
    pen.text((18, y - 12), f"{centimetres:g} cm", TEXT_COLOUR, font(12), anchor="lm")
    pen.rounded_rectangle((PANEL[0] / 2 - 47, y - 8, PANEL[0] / 2 + 47, y + 12), 5, (255, 255, 255))
    pen.text((PANEL[0] / 2, y + 2), "camera's side", TEXT_COLOUR, font(12), anchor="mm")
    return panel, section.height


def _scale_bar(metres_per_pixel: float) -> tuple[float, float]:
    """Length [cm] and width [px] of the longest round scale bar that leaves the middle of the panel free."""
    round_lengths = [mantissa * 10.0**power for power in range(-2, 5) for mantissa in (1, 2, 5)]
    widths = [(length, length / 100 / metres_per_pixel) for length in round_lengths]
    return max(((length, width) for length, width in widths if width <= LONGEST_BAR), default=widths[0])


def _dashes(segments: np.ndarray, length: float = 5.0) -> np.ndarray:
    """Cut segments (S, 2, 2) [px] to pieces and keep every other `length` px, by place in the picture."""
    pieces: list[list[np.ndarray]] = []
    for start, end in segments:
        count = max(int(np.ceil(np.linalg.norm(end - start) / length)), 1)
        ticks = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
        pieces.extend([ticks[i], ticks[i + 1]] for i in range(count))
    if not pieces:
        return segments
    cut = np.array(pieces)
    middle = cut.mean(axis=1).sum(axis=1) + cut.mean(axis=1) @ [0.0, 0.7]
    return cut[(middle // length).astype(int) % 2 == 0]


def _legend(reconstruction: Reconstruction, with_truth: bool) -> Image.Image:
    """Names with mean uncertainty in the objects' colours, the colour bar, and what was skipped."""
    column, line, bar_width = 300, 26, 360
    columns = (WIDTH - bar_width - 3 * GAP) // column
    objects, skipped = reconstruction.objects, reconstruction.skipped
    rows = max(-(-len(objects) // columns), 2)
    picture = Image.new("RGB", (WIDTH, rows * line + (24 if skipped else 0) + GAP), PAPER)
    draw = ImageDraw.Draw(picture)
    for index, item in enumerate(objects):
        x, y = GAP + index % columns * column, index // columns * line + line / 2
        draw.rounded_rectangle((x, y - 7, x + 14, y + 7), 3, _colour(item))
        draw.text((x + 22, y), _shorten(item.name, 22), TEXT_COLOUR, font(15), anchor="lm")
        used = draw.textlength(_shorten(item.name, 22), font(15))
        draw.text((x + 30 + used, y), f"mean {item.mean_uncertainty:.2f}", FAINT, font(13), anchor="lm")
    x = WIDTH - GAP - bar_width
    picture.paste(colour_bar(bar_width), (x, 6))
    if with_truth:
        draw.text((x + bar_width, 48), "dashed: truth", FAINT, font(12), anchor="rm")
    if skipped:
        text = "skipped: " + "; ".join(f"{item.name} ({item.reason})" for item in skipped)
        draw.text((GAP, rows * line + 10), _shorten(text, 170), FAINT, font(13), anchor="lm")
    return picture


def _colour(item: ReconstructedObject) -> tuple[int, int, int]:
    return object_colour(item.class_index - 1)


def _shorten(text: str, length: int) -> str:
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean if len(clean) <= length else clean[: length - 3] + "..."
