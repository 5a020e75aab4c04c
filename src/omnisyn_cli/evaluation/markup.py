"""HTML from values: whatever is not made here is text, and text is always escaped."""

from __future__ import annotations

import html

__all__ = ["Html", "element", "page"]

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What the page may load: nothing but what is in it."""

VOID = frozenset({"img", "meta", "br"})


class Html(str):
    """A string that is HTML already."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | bool) -> Html:
    """An element; children that are not :class:`Html` are escaped, and so are the values of attributes.

    A trailing underscore of an attribute's name is dropped (``class_``). True is an attribute without a value, False
    none at all.
    """
    opening = "".join([tag, *(_attribute(name.rstrip("_"), value) for name, value in attributes.items())])
    if tag in VOID:
        return Html(f"<{opening}>")
    content = "".join(child if isinstance(child, Html) else html.escape(child) for child in children)
    return Html(f"<{opening}>{content}</{tag}>")


def page(title: str, style: str, *body: Html) -> Html:
    """A whole document that needs nothing beside itself; ``style`` is CSS."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{html.escape(POLICY)}">'),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", title),
        Html(f"<style>{style}</style>"),
    )
    return Html("<!doctype html>\n" + element("html", head, element("body", *body), lang="en") + "\n")


def _attribute(name: str, value: str | bool) -> str:
    if isinstance(value, bool):
        return f" {name}" if value else ""
    return f' {name}="{html.escape(value)}"'
