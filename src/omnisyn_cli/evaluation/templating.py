"""Pages and Markdown, made from the files in ``templates``; whatever comes from values is escaped there."""

import base64
import re
from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.evaluation.grouping import Gap
from omnisyn_cli.evaluation.tables import Table, format_value

SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|!~&])")


def render_page(template: str, **values: Any) -> str:
    """A page that needs nothing beside itself."""
    return _environment(autoescape=True).get_template(template).render(values)


def render_markdown(tables: Sequence[Table], gaps: Sequence[Gap], version: str) -> str:
    """All tables and what was not measured; the best figures are bold."""
    template = _environment(finalize=_escaped).get_template("report.md.j2")
    return template.render(tables=tables, gaps=gaps, version=version)


def data_uri(data: bytes, kind: str) -> str:
    """A picture file of a kind (``png``, ``jpeg``) as an address that holds all of it."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _environment(**options: Any) -> Environment:
    environment = Environment(  # noqa: S701 - Markdown is escaped by `finalize`
        loader=PackageLoader("omnisyn_cli.evaluation"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **options,
    )
    environment.filters.update(figure=format_value, data_uri=data_uri)
    return environment


def _escaped(value: Any) -> str:
    """Text that Markdown shows as it is, on one line."""
    return SPECIAL.sub(r"\\\1", " ".join(str(value).split()))
