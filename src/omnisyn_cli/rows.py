"""When frames are made some rows at a time, so that no rendering is ever held as a whole picture.

That is where frames are wanted rounded to 8 bits and nothing else, nobody looks at whole renderings (to say how
confident a pixel is, or to cross-fade), both surfaces give rows and the fuser takes them. Said here once:
:mod:`omnisyn_cli.synthesis` asks about what it has made, :mod:`omnisyn_cli.planning` about names, before anything is
made and without the kernels.
"""

from __future__ import annotations

from omnisyn_cli.types import RowFuser, RowRenderer

__all__ = ["LEAST_ROWS", "ROW_FUSIONS", "ROW_RENDERERS", "are_frames_by_rows", "row_makers"]

ROW_RENDERERS = ("mesh",)
"""Names of the renderers that are :class:`~omnisyn_cli.types.RowRenderer`."""

ROW_FUSIONS = ("geometric",)
"""Names of the fusions whose fusers take rows."""

LEAST_ROWS = 897
"""Of a frame whose rows such a fuser takes: from here on few pixels are looked at twice."""


def row_makers(
    renderers: tuple[object, object], fuser: object, *, is_rounded: bool, is_judged: bool
) -> tuple[RowRenderer, RowRenderer, RowFuser] | None:
    """Both renderers and the fuser, if frames are made by rows with them.

    Args:
        renderers: of both views.
        fuser: joins what they show.
        is_rounded: frames are wanted as samples of 8 bits and in no other way.
        is_judged: whole renderings are looked at besides.
    """
    first, second = renderers
    if not is_rounded or is_judged or not isinstance(fuser, RowFuser) or not fuser.takes_rows():
        return None
    if not isinstance(first, RowRenderer) or not isinstance(second, RowRenderer):
        return None
    return first, second, fuser


def are_frames_by_rows(renderer: str, fusion: str, size: tuple[int, int], *, is_rounded: bool, is_judged: bool) -> bool:
    """Whether :func:`row_makers` will find some among what has these names.

    Args:
        renderer: a name of :data:`omnisyn_cli.planning.RENDERERS`.
        fusion: one of :data:`omnisyn_cli.presets.FUSIONS`.
        size: height and width of the frames.
        is_rounded: as there.
        is_judged: as there.
    """
    is_taken = fusion in ROW_FUSIONS and size[0] >= LEAST_ROWS and size[0] % 2 == size[1] % 2 == 0
    return is_rounded and not is_judged and renderer in ROW_RENDERERS and is_taken
