"""The documentation reads easily: short sentences, and a README of three pages.

Counted are README, CHANGELOG and every page of ``docs/`` and ``models/``. Code blocks, tables, headings, bold headings
in a paragraph, quoted lines, pictures and the targets of links are left out. An item of a list begins a sentence. So
does a capital, a digit or a backtick after a full stop, a question mark or an exclamation mark. A word stands between
spaces and has a letter or a digit, in code too. The README's length is that of the whole file, as ``wc -w`` counts it.
"""

from pathlib import Path
from statistics import mean

import pytest

from sentences import sentences

ROOT = Path(__file__).parents[1]

PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "models").glob("*.md")),
]

MAX_MEAN_WORDS = 18
"""Of the sentences of a page."""

MAX_WORDS = 40
"""Of a sentence."""

MAX_README_WORDS = 1300


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_sentences_are_short(page: Path) -> None:
    found = sentences(page.read_text(encoding="utf-8"))
    assert [sentence.text for sentence in found if sentence.length > MAX_WORDS] == []
    assert mean(sentence.length for sentence in found) <= MAX_MEAN_WORDS


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= MAX_README_WORDS


@pytest.mark.parametrize(
    ("page", "lengths"),
    [
        ("One two. Three `four. Five` six.", [2, 4]),
        ("# Heading\n\n| a | table |\n\nOne two\nthree.", [3]),
        ("**In short:** one. **Two** three.", [1, 2]),
        ("- one\n- two three.\n  Four five six.\n\n1. seven", [1, 2, 3, 1]),
        ("See [the page](far/away.md) – and ![no picture](a.png).", [4]),
        ("```\nnot this\n```\n\n    y = x\n\nThat. 3 is 3.5, e.g. Here.", [1, 5]),
    ],
)
def test_how_words_are_counted(page: str, lengths: list[int]) -> None:
    assert [sentence.length for sentence in sentences(page)] == lengths
