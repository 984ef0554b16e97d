"""scene.json: what a result folder says about itself."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mapping.plain_json import plain
from mapping.threads import thread_count
from perception.views.joint import JointObservation
from reconstruction.files.trust import trust

FORMAT = "contramap-result-1"
OTHER_FOLDER = "objects/other"
NAME_LENGTH = 48
"""Longest object name in a path; the full name is in scene.json."""
PACKAGES = (
    "contramap",
    "numpy",
    "scipy",
    "torch",
    "open3d",
    "scikit-image",
    "trimesh",
    "opencv-python-headless",
)

if TYPE_CHECKING:
    from reconstruction.result import ReconstructedObject, Reconstruction


def describe(reconstruction: Reconstruction, closed: Mapping[int, bool] | None = None) -> dict[str, Any]:
    """The content of scene.json; closed: label -> whether the object's mesh files load as closed surfaces."""
    frame, observation = reconstruction.frame, reconstruction.observation
    support = observation.support
    return plain(
        {
            "format": FORMAT,
            "frame": "world",
            "unit": "m",
            "source": frame.source,
            "T_world_camera": frame.camera.T_world_camera,
            "T_world_table": reconstruction.T_world_table,
            "map_labels": reconstruction.map_labels,
            "floor": reconstruction.floor,
            "support_plane": None if support is None else {"inlier_ratio": support.inlier_ratio},
            "objects": [
                _describe_object(item, reconstruction, closed or {}) for item in reconstruction.objects
            ],
            "other": _describe_other(reconstruction),
            "supports": _describe_supports(reconstruction),
            "skipped": [
                {"label": item.label, "name": item.name, "reason": item.reason}
                for item in reconstruction.skipped
            ],
            "notes": [*reconstruction.notes, *reconstruction.contradictions],
            **_describe_views(reconstruction),
            "timings_ms": reconstruction.timings_ms,
            "seed": reconstruction.seed,
            "threads": thread_count(),
            "config": reconstruction.config,
            "versions": _versions(),
        }
    )


def _describe_object(
    item: ReconstructedObject, reconstruction: Reconstruction, closed: Mapping[int, bool]
) -> dict[str, Any]:
    place = f"objects/{object_folder(item.label, item.name)}"
    return {
        "label": item.label,
        "name": item.name,
        "mesh": f"{place}/mesh.ply",
        "mesh_obj": f"{place}/mesh.obj",
        "T_world_object": item.T_world_object,
        "extents": item.extents,
        "mean_uncertainty": item.mean_uncertainty,
        "watertight": closed.get(item.label, item.watertight),
        "vertices": len(item.mesh.vertices),
        "faces": len(item.mesh.faces),
        **trust(item, reconstruction),
    }


def _describe_other(reconstruction: Reconstruction) -> dict[str, Any] | None:
    other = reconstruction.other
    if other is None:
        return None
    return {
        "mesh": f"{OTHER_FOLDER}/mesh.ply",
        "mesh_obj": f"{OTHER_FOLDER}/mesh.obj",
        "class_index": other.class_index,
        "mean_uncertainty": other.mean_uncertainty,
        "measured_pixels": len(reconstruction.observation.other.pixels),
        "vertices": len(other.mesh.vertices),
        "faces": len(other.mesh.faces),
    }


def _describe_views(reconstruction: Reconstruction) -> dict[str, Any]:
    """The views that a map of several was made from; nothing for a single frame."""
    observation = reconstruction.observation
    if not isinstance(observation, JointObservation):
        return {}
    views = [
        {
            "number": view.number,
            "source": view.frame.source,
            "T_world_camera": view.frame.camera.T_world_camera,
            "objects": view.labels,
        }
        for view in observation.views
    ]
    return {"views": views}


def _describe_supports(reconstruction: Reconstruction) -> list[dict[str, Any]]:
    """Each support that was found: its height in the table frame [m], and what stands on it."""
    observation = reconstruction.observation
    if observation.support is None:
        return []
    return [
        {"height": height, "carries": [item.label for item in observation.objects if item.floor == height]}
        for height in observation.levels
    ]


def to_json(content: dict[str, Any]) -> str:
    """JSON text with one line for each row of numbers."""
    text = json.dumps(content, indent=2, ensure_ascii=True, allow_nan=False)
    rows = re.compile(r"\[\n\s+(-?[\d.]+(?:e[+-]?\d+)?(?:,\n\s+-?[\d.]+(?:e[+-]?\d+)?)*)\n\s+\]")
    return rows.sub(lambda row: "[" + re.sub(r",\n\s+", ", ", row[1]) + "]", text) + "\n"


def safe_name(name: str) -> str:
    """An object name as one harmless path component: ASCII letters, digits, dot, dash and underscore."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    clean = re.sub(r"[^A-Za-z0-9._-]+", "_", ascii_name).strip("._-")[:NAME_LENGTH].strip("._-")
    return clean or "object"


def object_folder(label: int, name: str) -> str:
    """Name of an object's folder, <label>_<name>."""
    return f"{label}_{safe_name(name)}"


def _versions() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
