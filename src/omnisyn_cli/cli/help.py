"""Commands with many options, whose help is in sections; groups of commands, imported when they are called."""

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from omnisyn_cli.cli.failures import EXIT_CODES_LINE
from omnisyn_cli.cli.terminal import printable

# Parameters of `interpolate`, `view` and `export` by section, in order; those not named here are under the last.
SECTIONS: Mapping[str, str] = {
    "Input": "poses baseline camera_height refine path every new masks blur face_model nadir nadir_fill allow_aspect "
    "upper_half hfov vfov horizon view_transform max_pixels allow_outside",
    "Output": "output frames duration fps size format texture lossless folder serve is_opened stride sky dome clips "
    "codec crf encoder_preset audio save_confidence save_depth save_frames views stereo overwrite",
    "Quality and time": "preset budget fallback device threads",
    "Camera": "ease heading fov look",
    "Depth": "depth model depth_prior depth_prior_kind cut cut_metres",
    "For comparison": "method renderer adaptive fusion",
    "Other": "dry_run as_json verbose quiet help_all help",
}
# Parameters that only ``--help-all`` lists.
RARE_OPTIONS = (
    "refine", "nadir_fill", "allow_outside", "allow_aspect", "upper_half", "hfov", "vfov", "horizon", "view_transform",
    "max_pixels", "crf", "encoder_preset", "lossless", "stride", "sky", "dome", "save_depth", "save_confidence",
    "save_frames", "threads", "device", "depth", "model", "depth_prior", "depth_prior_kind", "cut", "cut_metres",
    "face_model", "fov", "look", "method", "renderer", "fusion", "adaptive",
)  # fmt: skip


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
        """The sections, each with its options."""
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
    """Options by the name of their section, in the order of :data:`SECTIONS`."""
    left = {option.name: option for option in options}
    found = {name: [left.pop(each) for each in names.split() if each in left] for name, names in SECTIONS.items()}
    found["Other"] += left.values()
    return found


def _show_all(context: click.Context, option: click.Parameter, is_wanted: bool) -> None:
    if is_wanted and not context.resilient_parsing:
        context.meta[_show_all.__name__] = True
        click.echo(context.get_help())
        context.exit()


class PlainGroup(click.Group):
    """A group that lists its commands in their order and in whole sentences, of which click cuts off all but a line.

    It says which command may have been meant by a word that is none, and what exit codes mean.
    """

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, whose help ends with the exit codes."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            command.epilog = EXIT_CODES_LINE
        return command

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order in which they were added."""
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is named; UsageError: a word that is none, with those that may have been meant."""
        known = self.list_commands(ctx)
        if args[0] not in known and not args[0].startswith("-") and not ctx.resilient_parsing:
            import difflib

            near = difflib.get_close_matches(args[0], known, n=2, cutoff=0.5)
            if "interpolate" in known and Path(args[0]).exists():
                near = [f"interpolate {args[0]}"]
            advice = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(known)}"
            ctx.fail(f"expected a command, got '{printable(args[0])}'; {advice}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Names with the first paragraph of each command's help."""
        with formatter.section("Commands"):
            commands = ((name, self.commands[name].help or "") for name in self.list_commands(ctx))
            formatter.write_dl([(name, " ".join(text.partition("\n\n")[0].split())) for name, text in commands])


class LazyGroup(PlainGroup):
    """A group whose commands are imported when they are called.

    ``lazy`` has the module and one-line help of each. The command has the name of its key, with ``_`` for ``-``, and
    one more at the end where that is a word of Python's.
    """

    def __init__(self, *, lazy: Mapping[str, tuple[str, str]], **options: Any) -> None:
        stubs = {name: click.Command(name, help=text) for name, (_, text) in lazy.items()}
        super().__init__(commands=stubs, **options)
        self.modules = {name: module for name, (module, _) in lazy.items()}

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in self.modules:
            return None
        module, name = importlib.import_module(self.modules[cmd_name]), cmd_name.replace("-", "_")
        command: click.Command = getattr(module, name, None) or getattr(module, f"{name}_")
        command.epilog = EXIT_CODES_LINE
        return command
