"""How far an object's result is supported by its frame: for scene.json, the printed table and the service.

Knows one reconstruction; knows nothing of files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perception.observation import ObservedObject
    from reconstruction.result import ReconstructedObject, Reconstruction

LITTLE_MEASURED = 0.5
"""An object less of whose mask is measured than this is named."""
FOOT_HIDDEN = 0.05
"""So is one that is seen from higher above its support on than this [m]."""


def trust(item: ReconstructedObject, reconstruction: Reconstruction, rays: bool = True) -> dict[str, Any]:
    """What a program needs to refuse what is weak.

    labelled_pixels, dropped_pixels, measured_pixels, guessed_pixels; support_height [m, table frame], None
    without a support, and support_seen; notes; with rays, which takes about 0.1 s for all objects together,
    also agreement and early_rays with the depth image within agreement_within [m].
    """
    seen = _observed(item, reconstruction)
    found = {
        "labelled_pixels": int(seen.labelled),
        "dropped_pixels": int(seen.dropped),
        "measured_pixels": len(seen.pixels),
        "guessed_pixels": len(seen.guessed),
        "support_height": None if reconstruction.observation.support is None else float(seen.floor),
        "support_seen": bool(seen.rests),
        "notes": object_notes(item, reconstruction, rays),
    }
    if not rays:
        return found
    of_rays = reconstruction.agreement[item.label]
    return {
        **found,
        "agreement": float(of_rays.agreement),
        "early_rays": float(of_rays.early_rays),
        "agreement_within": float(of_rays.tolerance),
    }


def object_notes(item: ReconstructedObject, reconstruction: Reconstruction, rays: bool = True) -> list[str]:
    """What speaks against relying on an object's result: short phrases, none if nothing does.

    rays: compare its mesh with the depth image as well.
    """
    seen = _observed(item, reconstruction)
    notes = []
    if len(seen.pixels) < LITTLE_MEASURED * seen.labelled:
        notes.append(f"only {len(seen.pixels) / seen.labelled:.0%} of its mask measured")
    if reconstruction.observation.support is None:
        notes.append("no support found")
    elif not seen.rests:
        notes.append("support not seen beside it")
    elif seen.bounds[0][2] - seen.floor > FOOT_HIDDEN:
        notes.append(f"seen from {1e3 * (seen.bounds[0][2] - seen.floor):.0f} mm above its support on")
    if reconstruction.observation.at_border(seen):
        notes.append("cut by the image's border")
    if rays and reconstruction.agreement[item.label].contradicts:
        notes.append("contradicts the depth image")
    return notes


def _observed(item: ReconstructedObject, reconstruction: Reconstruction) -> ObservedObject:
    return next(seen for seen in reconstruction.observation.objects if seen.label == item.label)
