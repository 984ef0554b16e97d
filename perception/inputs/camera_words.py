"""The names that people give to a camera's values, and a mapping asked by any of them. Knows no values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MATRIX = (
    "k", "camk", "intrinsics", "intrinsic", "cameramatrix", "intrinsicmatrix", "cameraintrinsics",
    "intrinsicsmatrix",
    "colorintrinsics", "depthintrinsics",
)  # fmt: skip
WIDTH, HEIGHT = ("width", "w", "imagewidth", "imwidth"), ("height", "h", "imageheight", "imheight")
SIZE = ("resolution", "imagesize", "size", "imsize")
SCALE = ("depthscale", "depthunit", "depthunits", "metresperunit", "metersperunit")
FACTOR = ("factordepth", "depthfactor", "pngdepthscale", "depthscalefactor", "unitspermetre", "unitspermeter")
DISTORTION = (
    "d", "distortion", "distcoeffs", "distcoeff", "distortioncoefficients", "coeffs", "distcoefs",
    "distortioncoeffs",
    "coefficients",
)  # fmt: skip
MODEL = ("distortionmodel", "cameramodel", "model")
LETTERS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
TO_WORLD = (
    "tworldcamera", "tworldcam", "cameratoworld", "camtoworld", "cam2world", "camera2world", "c2w",
    "camerapose", "pose",
    "cam2worldmatrix", "cameratoworldmatrix", "twc", "tbasecamera", "tbasecam",
)  # fmt: skip
FROM_WORLD = (
    "tcameraworld", "tcamworld", "worldtocamera", "worldtocam", "world2cam", "world2camera", "w2c", "tcw",
    "worldtocameramatrix", "tcamerabase", "tcambase",
)  # fmt: skip
UNSAID = ("extrinsics", "extrinsic", "t", "transform", "tmatrix", "extrinsicmatrix")
AXES = ("axes", "convention", "cameraaxes", "cameraconvention")
KIND = ("depthkind", "depthis", "depthtype")
COLOR = ("colorcamera", "color", "rgbcamera", "rgb", "colourcamera")
DEPTH = ("depthcamera", "depth", "infra1", "infrared")
COLOR_FROM_DEPTH = (
    "tcolordepth",
    "depthtocolor",
    "depth2color",
    "tcolourdepth",
    "trgbdepth",
    "depthtocolour",
)
DEPTH_FROM_COLOR = (
    "tdepthcolor",
    "colortodepth",
    "color2depth",
    "tdepthcolour",
    "tdepthrgb",
    "colourtodepth",
)
OF_NO_USE = {
    "header", "cameraname", "name", "binningx", "binningy", "roi", "rectificationmatrix", "r", "p",
    "projectionmatrix",
    "classname", "serial", "serialnumber", "frameid", "stamp", "version", "versionmajor", "versionminor",
    "fps", "unit",
    "fov", "fovx", "fovy", "hfov", "vfov", "comment", "description", "seq", "time", "timestamp", "device",
    "stream",
    "format", "viewlevel", "clsindexes", "poses", "streamtype",
}  # fmt: skip
UNIT_WORDS = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "metres": 1.0,
    "meters": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "um": 1e-6,
}
KINDS = ("z", "ray")
TRUST = ("unit", "kind", "K", "pose")
"""What a camera file can vouch for."""
LARGEST_SCALE = 0.02
"""No 16-bit depth image has units this large [m]; with BOP's keys such a scale counts in millimetres."""


class Keys:
    """A mapping asked by alias; knows which keys were never asked for."""

    def __init__(self, content: Mapping[str, Any], name: str) -> None:
        self.name = name
        self.content = {
            str(key).lower().replace("_", "").replace("-", "").replace(" ", ""): value
            for key, value in content.items()
        }
        self.spelt = {key: str(given) for key, given in zip(self.content, content)}
        self.used: set[str] = set()

    def take(self, aliases: tuple[str, ...]) -> Any:
        """The value of the first alias that is there, or None."""
        for alias in aliases:
            if alias in self.content:
                self.used.add(alias)
                return self.content[alias]
        return None

    def spelling(self, aliases: tuple[str, ...]) -> str:
        """The key as the file spells it."""
        return next(self.spelt[alias] for alias in aliases if alias in self.content)

    def unknown(self) -> list[str]:
        """Keys that were neither taken nor are known to be of no use."""
        return [self.spelt[key] for key in self.content if key not in self.used and key not in OF_NO_USE]
