"""One line of a manifest as a type: its files, and every option of an interpolation with the values it takes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError, create_model

from omnisyn_cli.errors import InputError
from omnisyn_cli.io import MAX_PIXELS
from omnisyn_cli.io.pose_models import place_of, sentence
from omnisyn_cli.planning import DEPTH_METHODS, RENDERER_CHOICES, InterpolationJob
from omnisyn_cli.presets import DEFAULT_PRESET, FUSION_CHOICES, METHODS, OMNISYN, PRESETS
from omnisyn_cli.runtime.session import DEVICES

__all__ = ["OUTPUTS", "PLACES", "Line", "check_options", "explained"]

OUTPUTS = ("output", "save_depth", "save_frames", "save_confidence")
"""What a job can leave behind, as it is called in a manifest and in :class:`InterpolationJob`."""

PLACES = ("id", "inputs", "scene", "poses", "group", *OUTPUTS)
"""What a line says beside the options of its interpolation."""

Fraction = Annotated[float, Field(gt=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Name = Annotated[str, StringConstraints(min_length=1)]


def _id(text: str) -> str:
    if not re.fullmatch(r"\w[\w.-]{0,119}", text):
        raise ValueError("at most 120 letters, digits, _, - and ., the first one a letter, digit or _")
    return text


def _size(text: str) -> str:
    if not re.fullmatch(r"[1-9][0-9]{0,5}x[1-9][0-9]{0,5}", text):
        raise ValueError("WIDTHxHEIGHT such as 2048x1024")
    return text


class _Places(BaseModel):
    """The part of a line that is about files."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Annotated[str, AfterValidator(_id)]
    inputs: Annotated[list[Name], Field(min_length=2)] | None = None
    scene: Name | None = None
    poses: Name | None = None
    group: Name | None = None
    output: Name | None = None
    save_depth: Name | None = None
    save_frames: Name | None = None
    save_confidence: Name | None = None


CONSTRAINED: dict[str, Any] = {
    "frames": (Annotated[int, Field(ge=2)] | None, None),
    "duration": (Positive | None, None),
    "fps": (Annotated[float, Field(gt=0, le=1000)], 30.0),
    "size": (Annotated[str, AfterValidator(_size)] | None, None),
    "method": (Literal[METHODS], OMNISYN),
    "preset": (Literal[tuple(PRESETS)], DEFAULT_PRESET),
    "depth": (Literal[DEPTH_METHODS], "auto"),
    "device": (Literal[DEVICES], "auto"),
    "renderer": (Literal[RENDERER_CHOICES], "auto"),
    "fusion": (Literal[FUSION_CHOICES], "auto"),
    "baseline": (Positive | None, None),
    "cut": (Fraction | None, None),
    "cut_metres": (Positive | None, None),
    "encoder_preset": (Name | None, None),
    "masks": (list[Name] | None, None),
    "nadir": (Annotated[float, Field(ge=0, lt=90)], 0.0),
    "max_pixels": (Annotated[int, Field(ge=1)], MAX_PIXELS),
}
"""Options whose values can be checked more closely than the types of :class:`InterpolationJob` say."""

OF_THE_RUN = {"images", "threads", "overwrite"}
"""Fields of :class:`InterpolationJob` that a line does not choose."""


def _options() -> dict[str, Any]:
    """Type and default of every option that a line may have."""
    hints = get_type_hints(InterpolationJob)
    known = {
        field.name: (hints[field.name], field.default)
        for field in fields(InterpolationJob)
        if field.name not in OF_THE_RUN | set(PLACES)
    }
    return {**known, **CONSTRAINED}


Line: Any = create_model("Line", __base__=_Places, **_options())
"""One line of a manifest."""


def check_options(options: Mapping[str, Any]) -> None:
    """Refuse what the jobs of a manifest cannot all say.

    Raises:
        InputError: an unknown option, one that is different for every job, or a value that it does not take.
    """
    common = sorted(set(Line.model_fields) - set(PLACES) | {"poses"})
    for name in options:
        if name not in common:
            raise InputError(f"expected an option for all jobs, got {name!r}; choose from {', '.join(common)}")
    try:
        Line.model_validate({"id": "job", "scene": "scene", **options})
    except ValidationError as error:
        raise InputError("; ".join(explained(error))) from None


def explained(error: ValidationError) -> Iterator[str]:
    """Every problem of a line: where, what was expected, what came and what to do."""
    for problem in error.errors(include_url=False):
        yield f"{place_of(problem['loc'])}: {sentence(problem, Line)}"
