"""JSON of which no two readers make different things."""

from __future__ import annotations

import json
from typing import Any, Never

__all__ = ["parse_json"]


class _DisagreementError(Exception):
    """What JSON readers disagree on; no ``ValueError``, which the reader takes for its own."""


def parse_json(text: str) -> Any:
    """The value that a text says, without repeated keys, NaN and infinity.

    Raises:
        ValueError: it is none; the message says what was expected, what came and what to do.
    """
    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=_refuse)
    except _DisagreementError as error:
        raise ValueError(str(error)) from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"expected JSON, got '{error}'; correct it there") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    seen: dict[str, Any] = {}
    for key, value in pairs:
        if key in seen:
            raise _DisagreementError(
                f"expected every key once, got '{key:.60}' twice in one object; remove one of them"
            )
        seen[key] = value
    return seen


def _refuse(constant: str) -> Never:
    raise _DisagreementError(f"expected finite numbers, got {constant}; write a number")
