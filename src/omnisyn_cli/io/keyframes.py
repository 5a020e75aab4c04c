"""Where a flat video looks over time, as its author writes it: a JSON list of moments."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from omnisyn_cli.io.documents import ForeignModel, read_json, validated


class Keyframe(ForeignModel):
    """Where the picture looks at a share of the video; degrees from the first panorama's centre, level."""

    at: Annotated[float, Field(ge=0, le=1)]
    yaw: Annotated[float, Field(ge=-3600, le=3600)]
    pitch: Annotated[float, Field(ge=-90, le=90)] = 0.0


class Keyframes(ForeignModel):
    """The file: a list of them, which may stand under one key."""

    keyframes: Annotated[list[Keyframe], Field(min_length=1)]


def read_keyframes(path: Path) -> list[Keyframe]:
    """The keyframes of a file, in the order of time; PoseError: missing, malformed or empty."""
    document = read_json(path, "keyframes")
    known = validated(path, Keyframes, {"keyframes": document} if isinstance(document, list) else document)
    return sorted(known.keyframes, key=lambda key: key.at)
