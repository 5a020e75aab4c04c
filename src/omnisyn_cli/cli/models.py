"""``omnisyn models``: the networks that came with the program."""

from pathlib import Path

import click

from omnisyn_cli.cli.options import print_json
from omnisyn_cli.cli.parameters import FilePath


@click.command()
@click.argument("folder", required=False, type=FilePath(file_okay=False, exists=True))
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def models(folder: Path | None, as_json: bool) -> None:
    """List the networks in FOLDER, by default those that came with the program, and check their files.

    Their names are what `--model` of `interpolate` takes.
    """
    from dataclasses import asdict

    from omnisyn_cli.runtime.models import find_model, read_manifest

    entries = read_manifest(folder)
    for name in entries:
        find_model(name, folder)
    if as_json:
        print_json([asdict(entry) for entry in entries.values()])
        return
    if not entries:
        click.echo("no models; make some with `omnisyn train` and `omnisyn export-onnx`")
    for entry in entries.values():
        (height, width), count = entry.size, entry.parameters
        counted = f"{count / 1e6:.1f} million" if count >= 1e5 else f"{count:,}"
        click.echo(f"{entry.name}: {entry.role}, {counted} parameters, {width}x{height}")
        click.echo(f"    trained on {entry.training}; {entry.licence}; sha256 {entry.sha256[:12]}…")
        if entry.metrics:
            click.echo("    " + ", ".join(f"{key} {value:.4g}" for key, value in entry.metrics.items()))
