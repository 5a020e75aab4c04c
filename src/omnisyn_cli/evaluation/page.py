"""The report as one HTML page: light and dark, readable on a telephone, nothing loaded from elsewhere."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence

from omnisyn_cli.evaluation.gallery import Section
from omnisyn_cli.evaluation.grouping import Gap, gaps
from omnisyn_cli.evaluation.markup import Html, element, page
from omnisyn_cli.evaluation.pictures import ERROR_SCALE
from omnisyn_cli.evaluation.records import UnitRecord
from omnisyn_cli.evaluation.table import Column, Row, Table, format_value

__all__ = ["PLOT_TITLES", "STYLE", "render_page", "table_section"]

PLOT_TITLES = {
    "ws-psnr-by-distance": "WS-PSNR against the distance from the nearer panorama",
    "ws-psnr-by-share": "WS-PSNR along the way",
    "ws-psnr-by-seconds": "Quality against time",
    "seconds-by-stage": "Seconds per pair, by stage",
}

STATUS_TITLES = {"done": "measured", "unavailable": "unavailable", "skipped": "skipped", "failed": "failed"}

ARROWS = {1: " ↑", -1: " ↓", 0: ""}
"""More is better, less is better."""

STYLE = """
:root { color-scheme: light dark; --text: #1c1e21; --faint: #5d646d; --back: #fff; --card: #f4f5f7; --line: #d9dce1;
  --best: #0a6640; --bad: #a3261b; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e8eb; --faint: #a0a7b1; --back: #15171a; --card: #1f2226;
  --line: #363b42; --best: #6fd6a2; --bad: #f08a80; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 84rem; padding: 1rem clamp(.75rem, 3vw, 2rem) 4rem; color: var(--text);
  background: var(--back); font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
h1 { font-size: 1.7rem; margin: .5rem 0; } h2 { font-size: 1.25rem; margin: 2.5rem 0 .5rem; }
h3 { font-size: 1rem; margin: 1rem 0 .25rem; font-weight: 600; }
p, .faint { color: var(--faint); margin: .25rem 0 .75rem; }
.counts { display: flex; flex-wrap: wrap; gap: .75rem; padding: 0; list-style: none; }
.counts li { background: var(--card); border-radius: .5rem; padding: .5rem 1rem; }
.counts b { font-size: 1.35rem; display: block; line-height: 1.2; } .failed b { color: var(--bad); }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: .5rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .4rem .75rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
tr:last-child > * { border-bottom: 0; }
thead th { color: var(--faint); font-weight: 600; background: var(--card); }
tbody th { font-weight: 500; } .words th, .words td { text-align: left; }
th:first-child { text-align: left; position: sticky; left: 0; background: var(--card); }
td.best { font-weight: 700; color: var(--best); } td.bound { color: var(--faint); font-style: italic; }
td.reason { text-align: left; white-space: normal; color: var(--faint); min-width: 16rem; }
small { color: var(--faint); }
figure { margin: 0; min-width: 0; } figcaption { color: var(--faint); font-size: .85rem; padding: .15rem 0 .5rem; }
img { display: block; width: 100%; height: auto; border-radius: .35rem; background: var(--card); }
.plots { display: grid; gap: 1.25rem; grid-template-columns: repeat(auto-fit, minmax(min(100%, 34rem), 1fr)); }
.plots img { background: #fff; border: 1px solid var(--line); }
.strip { display: grid; gap: .25rem .75rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 18rem), 1fr)); }
details { border-top: 1px solid var(--line); padding: .5rem 0; } summary { cursor: pointer; font-weight: 600; }
@media (max-width: 40rem) { body { font-size: 15px; } th, td { padding: .35rem .5rem; }
  tbody th { white-space: normal; min-width: 7rem; } small { display: block; } }
"""


def render_page(
    records: Sequence[UnitRecord],
    tables: Sequence[Table],
    plots: Mapping[str, bytes],
    frames: Sequence[Section],
    depths: Sequence[Section],
    version: str,
) -> str:
    """The whole document.

    Args:
        records: one for each unit.
        tables: in the order in which they are shown.
        plots: name of a diagram, a key of :data:`PLOT_TITLES` -> PNG file.
        frames: pictures of frames, by method.
        depths: pictures of depth, by panorama.
        version: of the program.
    """
    title = "OmniSyn evaluation"
    return page(
        title, STYLE, element("h1", title), element("p", f"omnisyn {version}"), _counts(records),
        *(table_section(table) for table in tables[:1]), _gaps(gaps(records)), _plots(plots),
        *(table_section(table) for table in tables[1:]),
        _sections("Worst frames", f"Of each method, the frames with the lowest WS-PSNR first. Error: mean difference "
                  f"of the channels, black 0, pale yellow {ERROR_SCALE} or more.", frames),
        _sections("Depth", "Red is near, dark blue far, black unknown.", depths),
    )  # fmt: skip


def _counts(records: Sequence[UnitRecord]) -> Html:
    """How many units ended how."""
    found = Counter[str](record.status for record in records)
    if not found:
        return element("p", "Nothing has been measured yet.")
    tiles = [
        element("li", element("b", str(found[status])), title, class_=status)
        for status, title in STATUS_TITLES.items()
        if status in found
    ]
    return element("ul", *tiles, class_="counts")


def table_section(table: Table) -> Html:
    """A table with its title and its note."""
    head = element("tr", element("th", table.corner), *(_heading(column) for column in table.columns))
    body = [_row(row, table.columns) for row in table.rows]
    content = element("table", element("thead", head), element("tbody", *body))
    return element(
        "section", element("h2", table.title), element("p", table.note), element("div", content, class_="scroll")
    )


def _heading(column: Column) -> Html:
    return element("th", column.title + ARROWS[column.better])


def _row(row: Row, columns: Sequence[Column]) -> Html:
    name = element("th", row.name, *([element("small", " (upper bound)")] if row.is_bound else []))
    if not row.cells:
        return element("tr", name, element("td", row.reason, class_="reason", colspan=str(len(columns))))
    cells = (
        element("td", format_value(cell.value, column.digits), class_=_kind(cell.is_best, row.is_bound))
        for cell, column in zip(row.cells, columns, strict=True)
    )
    return element("tr", name, *cells)


def _kind(is_best: bool, is_bound: bool) -> str:
    return "best" if is_best else "bound" if is_bound else "plain"


def _gaps(found: Sequence[Gap]) -> Html:
    if not found:
        return Html("")
    rows = [
        element(
            "tr", element("th", gap.method or "all methods"), element("td", STATUS_TITLES.get(gap.status, gap.status)),
            element("td", gap.reason, class_="reason"), element("td", ", ".join(gap.pairs), class_="reason"),
        )
        for gap in found
    ]  # fmt: skip
    head = element("tr", *(element("th", title) for title in ("Method", "Status", "Reason", "Scenes")))
    content = element("table", element("thead", head), element("tbody", *rows), class_="words")
    return element("section", element("h2", "Not measured"), element("div", content, class_="scroll"))


def _plots(plots: Mapping[str, bytes]) -> Html:
    if not plots:
        return Html("")
    figures = []
    for name, data in plots.items():
        uri = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
        figures.append(_figure(uri, PLOT_TITLES.get(name, name)))
    return element("section", element("h2", "Diagrams"), element("div", *figures, class_="plots"))


def _sections(title: str, note: str, sections: Sequence[Section]) -> Html:
    if not sections:
        return Html("")
    parts = [_section(section, is_open=index == 0) for index, section in enumerate(sections)]
    return element("section", element("h2", title), element("p", note), *parts)


def _section(section: Section, *, is_open: bool) -> Html:
    strips: list[Html] = []
    for strip in section.strips:
        pictures = (_figure(picture.uri, picture.caption) for picture in strip.pictures)
        strips += [element("h3", strip.title)] if strip.title else []
        strips.append(element("div", *pictures, class_="strip"))
    return element("details", element("summary", section.title), *strips, open=is_open)


def _figure(uri: str, caption: str) -> Html:
    return element("figure", element("img", src=uri, alt=caption), element("figcaption", caption))
