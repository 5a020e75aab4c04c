"""One line of a manifest as a type: its files, and every option of an interpolation with the values it takes."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError, create_model

from omnisyn_cli.errors import InputError
from omnisyn_cli.interpolation.job import CHOICES, InterpolationJob
from omnisyn_cli.io.documents import place_of, sentence

OUTPUTS = ("output", "save_depth", "save_frames", "save_confidence", "view")
"""What a job can leave behind, as it is called in a manifest and in :class:`InterpolationJob`."""

PLACES = ("id", "inputs", "scene", "poses", "group", *OUTPUTS)
"""What a line says beside the options of its interpolation."""

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

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    id: Annotated[str, AfterValidator(_id)]
    inputs: Annotated[list[Name], Field(min_length=2)] | None = None
    scene: Name | None = None
    poses: Name | None = None
    group: Name | None = None
    output: Name | None = None
    save_depth: Name | None = None
    save_frames: Name | None = None
    save_confidence: Name | None = None
    view: Name | None = None


CONSTRAINED: Mapping[str, Any] = {
    "size": Annotated[str, AfterValidator(_size)] | None,
    "encoder_preset": Name | None,
    "masks": list[Name] | None,
    "nadir": Annotated[float, Field(ge=0, lt=90)],
    **{name: Literal[names] for name, names in CHOICES.items()},
}
"""Types of options that a line writes in another way than :class:`InterpolationJob`, which says all other ranges."""

OF_THE_RUN = {"images", "threads", "overwrite"}
"""Fields of :class:`InterpolationJob` that a line does not choose."""


def _options() -> dict[str, Any]:
    """Type and default of every option that a line may have."""
    hints = {**get_type_hints(InterpolationJob, include_extras=True), **CONSTRAINED}
    return {
        field.name: (hints[field.name], None if field.default == () else field.default)
        for field in fields(InterpolationJob)
        if field.name not in OF_THE_RUN | set(PLACES)
    }


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
