"""The documentation reads easily: short sentences, and a README of three pages.

Counted are README, CHANGELOG and every page of ``docs/`` and ``models/``. Code blocks, tables, headings, bold headings
in a paragraph, quoted lines, pictures and the targets of links are left out. An item of a list begins a sentence. So
does a capital, a digit or a backtick after a full stop, a question mark or an exclamation mark. A word stands between
spaces and has a letter or a digit, in code too. The README's length is that of the whole file, as ``wc -w`` counts it.
"""

import re
from pathlib import Path
from statistics import mean

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "models").glob("*.md")),
]

MAX_MEAN_WORDS = 18  # Of the sentences of a page.
MAX_WORDS = 40  # Of a sentence.
MAX_README_WORDS = 1300
FENCE = re.compile(r"^ *```.*?^ *```[^\n]*$", re.M | re.S)
COMMENT = re.compile(r"<!--.*?-->", re.S)
IMAGE = re.compile(r"!\[[^\]]*\]\([^)]*\)")
LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
CODE = re.compile(r"`[^`]*`")

# Rows of tables, headings, quoted lines (output, formulas) and targets of links.
LEFT_OUT = re.compile(r"^ *(\||#|>|\[[^\]]+\]:)")
ITEM = re.compile(r"^ *([-*+]|\d+[.)]) +")
FORMULA = re.compile(r"^ {4,}\S")  # Only after an empty line outside of a list: otherwise it goes on with an item.
LEAD = re.compile(r"^\*\*[^*]+[.:]\*\* +")  # A heading in the line of its paragraph.
END = re.compile(r"(?<=[.!?])[\"”»)*_]* +(?=[\"“«(*_\[]*[A-Z0-9`δ±≈])")
ABBREVIATION = re.compile(r"\b(e\.g|i\.e|etc|vs|al|approx|Fig|Sec|No)\.$")


def words_of(text: str) -> list[str]:
    """What stands between spaces and has a letter or a digit; code counts as it is written."""
    return [word for word in text.split() if re.search(r"\w", word)]


def paragraphs(page: str) -> list[str]:
    """Prose of a page: paragraphs and items of lists, each in one line."""
    page = COMMENT.sub("", FENCE.sub("\n\n", page))
    page = LINK.sub(r"\1", IMAGE.sub("", page))
    found: list[list[str]] = [[]]
    is_in_list = False
    for line in page.splitlines():
        if not line.strip() or LEFT_OUT.match(line):
            found.append([])
            continue
        is_item = ITEM.match(line) is not None
        if not found[-1] and not is_item:
            is_in_list = is_in_list and line.startswith(" ")
        if not is_in_list and not is_item and not found[-1] and FORMULA.match(line):
            continue
        if is_item:
            found.append([])
            is_in_list = True
        found[-1].append(ITEM.sub("", line).strip())
    return [LEAD.sub("", " ".join(lines)) for lines in found if lines]


def sentences(page: str) -> list[tuple[int, str]]:
    """Sentences of the prose of a Markdown page, or items without a full stop, in its order, after their lengths."""
    return [(len(words_of(text)), text) for paragraph in paragraphs(page) for text in split(paragraph)]


def split(paragraph: str) -> list[str]:
    """Sentences of a paragraph; full stops inside code and after abbreviations end none."""
    hidden = CODE.sub(lambda match: f"`{'x' * (len(match[0]) - 2)}`", paragraph)
    parts, start = [], 0
    for match in END.finditer(hidden):
        if not ABBREVIATION.search(hidden[start : match.start()]):
            parts.append(paragraph[start : match.end()].strip())
            start = match.end()
    parts.append(paragraph[start:].strip())
    return [part for part in parts if words_of(part)]


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_sentences_are_short(page: Path) -> None:
    found = sentences(page.read_text(encoding="utf-8"))
    assert [text for words, text in found if words > MAX_WORDS] == []
    assert mean(words for words, _ in found) <= MAX_MEAN_WORDS


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
    assert [words for words, _ in sentences(page)] == lengths
