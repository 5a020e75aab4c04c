"""One line of a manifest as a type: its files, and every option of an interpolation with the values it takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, Self, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, create_model, model_validator

from omnisyn_cli.errors import InputError
from omnisyn_cli.io import MAX_PIXELS
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


class _Places(BaseModel):
    """The part of a line that is about files."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Annotated[str, StringConstraints(pattern=r"^\w[\w.-]*$", max_length=120)]
    inputs: Annotated[list[Name], Field(min_length=2)] | None = None
    scene: Name | None = None
    poses: Name | None = None
    group: Name | None = None
    output: Name | None = None
    save_depth: Name | None = None
    save_frames: Name | None = None
    save_confidence: Name | None = None

    @model_validator(mode="after")
    def _has_panoramas(self) -> Self:
        if self.scene is None and (self.inputs is None or self.poses is None):
            raise ValueError("expected inputs with poses, or a scene; name one of them")
        return self


CONSTRAINED: dict[str, Any] = {
    "frames": (Annotated[int, Field(ge=2)] | None, None),
    "duration": (Positive | None, None),
    "fps": (Annotated[float, Field(gt=0, le=1000)], 30.0),
    "size": (Annotated[str, StringConstraints(pattern=r"^[1-9]\d{0,5}x[1-9]\d{0,5}$")] | None, None),
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
    """Every problem of a line: where, what is wrong, and what was given."""
    for detail in error.errors(include_url=False):
        where = ".".join(str(part) for part in detail["loc"])
        given = "" if detail["type"] in ("missing", "value_error") else f", got {detail['input']!r:.80}"
        yield f"{where + ': ' if where else ''}{detail['msg'].removeprefix('Value error, ')}{given}"
