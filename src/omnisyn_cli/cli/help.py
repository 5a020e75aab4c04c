"""Help of commands with many options: in sections, and without rarely used options unless they are asked for."""

from collections.abc import Iterable, Mapping
from typing import Any

import click

SECTIONS: Mapping[str, str] = {
    "Input": "every path poses baseline camera_height refine masks nadir nadir_fill allow_outside allow_aspect "
    "upper_half hfov vfov horizon view_transform max_pixels",
    "Output": "output frames duration fps size format views stereo codec crf encoder_preset texture lossless "
    "folder serve is_opened clips stride sky dome save_depth save_confidence save_frames overwrite",
    "Quality and time": "preset budget fallback device threads",
    "Camera": "ease heading fov look",
    "Depth": "depth model cut cut_metres",
    "For comparison": "method renderer fusion adaptive",
    "Other": "dry_run as_json verbose quiet help_all help",
}
"""Parameters of `interpolate`, `view` and `export` by section, in order; those not named here are under the last."""

RARE_OPTIONS = (
    "refine", "nadir_fill", "allow_outside", "allow_aspect", "upper_half", "hfov", "vfov", "horizon", "view_transform",
    "max_pixels", "crf", "encoder_preset", "lossless", "stride", "sky", "dome", "save_depth", "save_confidence",
    "save_frames", "threads", "device", "depth", "model", "cut", "cut_metres",
    "fov", "look", "method", "renderer", "fusion", "adaptive",
)  # fmt: skip
"""Parameters that only ``--help-all`` lists."""


class SectionedCommand(click.Command):
    """A command whose help lists options by section, with ``--help-all`` for the rare ones."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all,
                help="Show this message with all options and exit.",
            )
        )  # fmt: skip

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The sections, each with its options in the order in which the command declares them."""
        is_complete = ctx.meta.get(_show_all.__name__, False)
        options = [param for param in self.get_params(ctx) if isinstance(param, click.Option)]
        for section, shown in by_section(options).items():
            records = [each.get_help_record(ctx) for each in shown if is_complete or each.name not in RARE_OPTIONS]
            if rows := [record for record in records if record is not None]:
                with formatter.section(section):
                    formatter.write_dl(rows)
        hidden = sum(option.name in RARE_OPTIONS for option in options)
        if hidden and not is_complete:
            formatter.write_paragraph()
            formatter.write_text(f"--help-all lists {hidden} more options.")


def by_section(options: Iterable[click.Option]) -> dict[str, list[click.Option]]:
    """Options by the name of their section, in the order of the sections."""
    home: dict[str | None, str] = {name: section for section, names in SECTIONS.items() for name in names.split()}
    found: dict[str, list[click.Option]] = {section: [] for section in SECTIONS}
    for option in options:
        found[home.get(option.name, "Other")].append(option)
    return found


def _show_all(context: click.Context, option: click.Parameter, is_wanted: bool) -> None:
    if is_wanted and not context.resilient_parsing:
        context.meta[_show_all.__name__] = True
        click.echo(context.get_help())
        context.exit()
