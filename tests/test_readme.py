"""The documentation's commands are commands: they parse, their files exist, and the README's first one would run."""

import re
import shlex
from pathlib import Path

import click
import pytest

from omnisyn_cli.cli import cli

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCUMENTS = [ROOT / "CONTRIBUTING.md", README, *sorted(ROOT.glob("[a-z]*/*.md"))]

WITHOUT_MORE = {"--help", "--list-methods"}
"""Options that print something and end the command."""


def commands(document: Path) -> list[list[str]]:
    """Every ``omnisyn`` command in the code blocks of a document, as words."""
    blocks = re.findall(r"^```(?:sh|console|bash)?\n(.*?)^```", document.read_text(encoding="utf-8"), re.M | re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    parts = [part.strip() for line in lines for part in line.split("&&")]
    return [shlex.split(part, comments=True)[1:] for part in parts if part.startswith("omnisyn ")]


CASES = [(document, words) for document in DOCUMENTS for words in commands(document)]


@pytest.mark.parametrize(("document", "words"), CASES, ids=[" ".join(words) for _, words in CASES])
def test_every_command_parses(document: Path, words: list[str]) -> None:
    command: click.Command = cli
    with click.Context(cli, info_name="omnisyn", **cli.context_settings) as context:
        while isinstance(command, click.Group):
            found = command.get_command(context, words[0])
            assert found is not None, f"{document.name}: there is no command {words[0]}"
            command, words = found, words[1:]
        if not WITHOUT_MORE & set(words):
            command.make_context(command.name, list(words), parent=context)


@pytest.mark.parametrize(("document", "words"), CASES, ids=[" ".join(words) for _, words in CASES])
def test_every_example_that_is_named_exists(document: Path, words: list[str]) -> None:
    for word in words:
        if word.startswith("examples/"):
            assert (ROOT / word).exists(), f"{document.name} names {word}"


def test_the_set_up_is_the_two_lines_that_were_promised() -> None:
    text = README.read_text(encoding="utf-8")
    assert (
        "python -m pip install . && omnisyn interpolate examples/street/first.jpg examples/street/second.jpg "
        "--poses examples/street/poses.json -o street.mp4\n```\n```\n"
        'python -m pip install ".[test]" && python -m pytest\n'
    ) in text


def test_the_readme_opens_with_a_picture_that_exists() -> None:
    picture = re.search(r"!\[[^\]]+\]\(([^)]+)\)", README.read_text(encoding="utf-8")[:1500])
    assert picture is not None
    assert (ROOT / picture.group(1)).is_file()


def test_links_to_files_lead_somewhere() -> None:
    for document in DOCUMENTS:
        for link in re.findall(r"\]\((?!https?://|#|mailto:)([^)#]+)", document.read_text(encoding="utf-8")):
            assert (document.parent / link).exists(), f"{document.name} links to {link}"


def test_the_first_command_can_be_planned(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    words = next(words for document, words in CASES if document == README and "examples/street/first.jpg" in words)
    monkeypatch.chdir(ROOT)
    arguments = [*words[: words.index("-o")], "-o", str(tmp_path / "street.mp4"), "--dry-run", "--json"]
    assert cli.main(arguments, standalone_mode=False) is None
    assert not list(tmp_path.iterdir())
